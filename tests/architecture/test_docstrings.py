"""Docstrings: a public function with three parameters or more says what they are, what it returns and what it raises.

The form is Google's. A section Returns may be missing where the summary itself begins with "Return". Commands of the
command line are exempt: their docstrings are the help that `--help` prints, and their options carry their own.
"""

import ast
import re
from collections.abc import Iterator

import pytest
from source import SOURCES, syntax

FEWEST_PARAMETERS = 3

Function = ast.FunctionDef | ast.AsyncFunctionDef


def public_functions(module: str) -> Iterator[tuple[str, Function]]:
    """Find the public functions of a module and the public methods of its public classes."""
    for node in syntax(module).body:
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
            for inner in node.body:
                if isinstance(inner, Function) and not inner.name.startswith("_"):
                    yield f"{node.name}.{inner.name}", inner
        elif isinstance(node, Function) and not node.name.startswith("_"):
            yield node.name, node


def decorators(function: Function) -> list[str]:
    """Give the decorators as they stand in the source, without arguments."""
    return [ast.unparse(one.func if isinstance(one, ast.Call) else one) for one in function.decorator_list]


def parameters(function: Function) -> list[str]:
    """Name the parameters, without self and cls."""
    given = function.args
    every = [*given.posonlyargs, *given.args, *given.kwonlyargs, *filter(None, (given.vararg, given.kwarg))]
    return [one.arg for one in every if one.arg not in ("self", "cls")]


def raised(function: Function) -> set[str]:
    """Name the public errors that the function itself raises."""
    found: set[str] = set()
    pending = list(ast.iter_child_nodes(function))
    while pending:
        node = pending.pop()
        if isinstance(node, Function | ast.Lambda | ast.ClassDef):
            continue
        if isinstance(node, ast.Raise) and node.exc is not None:
            error = node.exc.func if isinstance(node.exc, ast.Call) else node.exc
            name = ast.unparse(error).rpartition(".")[2]
            if re.fullmatch(r"[A-Z]\w+", name) and name not in ("AssertionError", "NotImplementedError", "Exit"):
                found.add(name)
        pending += ast.iter_child_nodes(node)
    return found


def section(docstring: str, name: str) -> str | None:
    """Cut a section out of a docstring."""
    found = re.search(rf"^{name}:\n(.*?)(?=^\S|\Z)", docstring, flags=re.M | re.S)
    return found[1] if found else None


def entries(text: str) -> set[str]:
    """Name what a section has entries for; an entry may be for several: ``x, y: [m].``"""
    names = re.findall(r"^    ([*\w.]+(?:, [*\w.]+)*)(?: \([^)]*\))?:", text, flags=re.M)
    return {one.strip("*") for several in names for one in several.split(", ")}


def missing(function: Function) -> Iterator[str]:
    """Say what a docstring lacks."""
    docstring = ast.get_docstring(function) or ""
    if not docstring:
        yield "no docstring"
        return
    arguments = section(docstring, "Args")
    if arguments is None:
        yield "no Args"
    elif unnamed := [name for name in parameters(function) if name not in entries(arguments)]:
        yield f"Args without {', '.join(unnamed)}"
    returned = ast.unparse(function.returns) if function.returns else "None"
    returns = not re.match(r"None$|NoReturn|Never|(contextlib\.|typing\.)?(Iterator|Generator)\b", returned)
    if returns and section(docstring, "Returns") is None and not re.match(r"Returns? ", docstring):
        yield "no Returns"
    if unnamed := raised(function) - entries(section(docstring, "Raises") or ""):
        yield f"Raises without {', '.join(sorted(unnamed))}"


@pytest.mark.parametrize("module", SOURCES)
def test_a_public_function_documents_its_parameters(module: str) -> None:
    found = [
        f"{module}:{function.lineno}: {name}: {what}"
        for name, function in public_functions(module)
        if len(parameters(function)) >= FEWEST_PARAMETERS
        and not any(re.search(r"\.(command|callback)$|^with_options$|^overload$", one) for one in decorators(function))
        for what in missing(function)
    ]
    if found:
        pytest.fail("\n".join(found), pytrace=False)
