"""The vocabulary: words that newcomers know, and one word for one thing.

``WORDS`` is the table of retired words. None of them may return as part of an identifier or a file name, in a string,
comment or docstring, or on a page. Identifiers are split at underscores and capitals, so ``take_party`` and
``TakeParty`` both contain ``party``. Names that follow a dot belong to somebody else's module (``ast.walk``) unless
the object is ``self``.
"""

import ast
import io
import re
import tokenize
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import PurePath

import pytest
from source import ROOT, tracked_files


@dataclass(frozen=True)
class Word:
    """A retired word or phrase."""

    instead: str
    """What to write."""
    name: str = ""
    """Regular expression of the words of an identifier, joined by underscores."""
    prose: str = ""
    """Regular expression of a phrase."""
    where: str = ""
    """Regular expression of the paths where it is retired; everywhere if empty."""
    except_in: str = r"$^"
    """Regular expression of the paths where it has its ordinary meaning."""


FABRICATION = r"fabrication/|assembly|servo|bench|kit"
"""Where a part may be cut into pieces and lie beside another."""
BOX2D = r"simulation/(test_)?reference|rigid_bodies|benchmarks/obvious|physics/test_pendulum"
"""Where a world is a b2World."""
METHODS_CALLED_OF = r"residual/network|simulation/controller|simd/vectors|tracks/smoother"
"""Where a class has a method that reads as in ``Controllers.of(designs)``."""

WORDS = (
    Word("work item", r"pieces?", r"pieces?", except_in=FABRICATION),
    Word("batch, batch of items", r"party|parties", r"(?<!third-)(?<!third )\b(party|parties)"),
    Word("batched", r"abreast|side_by_side|in_company", r"abreast|in company"),
    Word("batched", prose=r"side by side", except_in=rf"{FABRICATION}|pipeline/report|tasks/simulation/"),
    Word("chain progress", r"(?<!random_)walk(s|ed)?", except_in=r"tests/physics/"),
    Word("execution options", r"^how$"),
    Word("failed (after N attempts), quarantined", r"sets?_aside", r"set(s|ting)?( \w+){0,3} aside"),
    Word("committed, cached", r"^kept$", where=r"pipeline/(store|workflow|cluster|commands|stages|tracking)/"),
    Word("supervisor", r"keepers?", r"keepers?"),
    Word("preflight check", r"hello"),
    Word("preflight check", r"reach", where=r"pipeline/cluster/"),
    Word("watchdog, started calls", r"marks", where=r"pipeline/cluster/"),
    Word("calibration run", r"specimens?", r"specimens?"),
    Word("empty population", r"nobody", r"nobody"),
    Word("parent indices", r"places", where=r"tasks/evolution/|tests/tasks/evolution/"),
    Word("rejection sampling", prose=r"drawn again until|drawn until"),
    Word("controller", r"drives?", where=r"(tasks|tests/tasks)/(simulation|world|design)/"),
    Word("servo, play", r"drives?", where=r"pipeline/servo/"),
    Word("prediction; bound, guarantee", r"promis\w+", r"promis\w+", except_in=r"shared/browser|report/test_browser"),
    Word("model exploitation", prose=r"liv(es?|ing) off"),
    Word("hallucinated dynamics", r"imagined", r"imagined"),
    Word("environment, arm", r"^_?worlds?$|world_of|world_inputs|shared_world|n_worlds\w*", except_in=BOX2D),
    Word("fork server", r"nursery|nurseries", r"nursery|nurseries"),
    Word("crash-consistency disk", r"volatile", r"volatile"),
    Word("got, received", r"^came$", r"expected\b[^.;]{0,80}\bcame\b|came (\{|%)"),
    Word("nothing, no one, or the passive voice", prose=r"nobody"),
    Word("that many, or the number", prose=r"(?<!not )so many(?! that)"),
    Word("remove", prose=r"tak(es?|en|ing) away"),
    Word("the noun that it stands for", r"^of$", where=r"^(tasks|pipeline)/", except_in=METHODS_CALLED_OF),
    Word("a noun phrase without 'Of'", prose=r"^(?-i:Of)(?! course)"),
)

FILES = {
    "abreast": "batched",
    "bodies": "rigid_bodies",
    "drive": "controller or servo",
    "hello": "preflight",
    "how": "execution options",
    "keeper": "supervisor",
    "kernels": "trees",
    "marks": "watchdog",
    "nursery": "fork_server",
    "places": "parent indices",
    "rates": "cost_model",
    "reach": "preflight",
    "rows": "layout",
    "sizes": "cost_model",
    "specimens": "calibration",
    "volatile": "crash_consistency_disk",
}
"""Retired names of modules, and what to call them."""

THIS_FILE = "tests/architecture/test_words.py"
PYTHON = [name for name in tracked_files("*.py") if name != THIS_FILE]
PAGES = tracked_files("README.md", "docs/*.md", "pipeline/*.html", "pipeline/*.js", "pipeline/*.css", "configs/*.yaml")
PAGES += tracked_files("Makefile", "pyproject.toml", "docker/*", ".ci/*")


def words_of(identifier: str) -> str:
    """Split an identifier at underscores and capitals; join its words by underscores."""
    parts = re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+", identifier)
    return "_".join(part.lower() for part in parts)


def identifiers(tokens: Iterable[tokenize.TokenInfo]) -> Iterator[tuple[int, str]]:
    """Find the names that a module defines or uses, with their lines."""
    before = ["", ""]
    for token in tokens:
        foreign = before[-1] == "." and before[-2] not in ("self", "cls", "tasks")
        of_package = before[-1] == "." and before[-2] == "tasks"  # tasks.world is the name of a package
        if token.type == tokenize.NAME and not (foreign or of_package):
            yield token.start[0], token.string
        if token.type not in (tokenize.NL, tokenize.COMMENT):
            before = [before[-1], token.string]


def prose(text: str, tokens: Iterable[tokenize.TokenInfo]) -> Iterator[tuple[int, str]]:
    """Find the comments and strings of a module, with their lines."""
    comment: list[tuple[int, str]] = []
    for token in tokens:
        if token.type == tokenize.COMMENT:
            comment.append((token.start[0], token.string.lstrip("# ")))
        elif comment and token.type != tokenize.NL:
            yield comment[0][0], " ".join(line for _, line in comment)
            comment = []
    inner = set()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.JoinedStr):
            inner |= {id(value) for value in node.values}
            yield node.lineno, "".join(v.value if isinstance(v, ast.Constant) else "{}" for v in node.values)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in inner:
            yield node.lineno, node.value


def retired(path: str, names: list[tuple[int, str]], texts: list[tuple[int, str]]) -> Iterator[str]:
    """Find the retired words of a file; say what to write for each."""
    split = [(line, name, words_of(name)) for line, name in names]
    distinct = {words for _, _, words in split}
    flat = [(line, " ".join(text.split())) for line, text in texts]
    together = "\n".join(text for _, text in flat)  # most words are in none, and one search is faster than thousands
    for word in WORDS:
        if not re.search(word.where, path) or re.search(word.except_in, path):
            continue
        if word.name:
            pattern = re.compile(rf"(?:^|_)({word.name})(?=_|$)")
            with_it = {words for words in distinct if pattern.search(words)}
            for line, name, words in split:
                if words in with_it:
                    yield f"{path}:{line}: {name}: write {word.instead}"
        if word.prose:
            pattern = re.compile(rf"(?<!\w)(?:{word.prose})(?!\w)", re.IGNORECASE | re.MULTILINE)
            for line, text in flat if pattern.search(together) else ():
                for found in pattern.finditer(text):
                    around = text[max(0, found.start() - 20) : found.end() + 20]
                    yield f"{path}:{line}: …{around}…: write {word.instead}"


@pytest.mark.parametrize("path", PYTHON)
def test_a_module_uses_standard_words(path: str) -> None:
    text = (ROOT / path).read_text()
    tokens = list(tokenize.generate_tokens(io.StringIO(text).readline))
    found = [*retired(path, list(identifiers(tokens)), list(prose(text, tokens)))]
    stem = PurePath(path).stem.removeprefix("test_")
    if stem in FILES:
        found.append(f"{path}: the file's name: write {FILES[stem]}")
    if found:
        pytest.fail("\n".join(found), pytrace=False)


@pytest.mark.parametrize("path", PAGES)
def test_a_page_uses_standard_words(path: str) -> None:
    paragraphs, line = [], 1
    for paragraph in re.split(r"(\n\s*\n)", (ROOT / path).read_text()):
        paragraphs.append((line, paragraph))
        line += paragraph.count("\n")
    found = list(retired(path, [], paragraphs))
    if found:
        pytest.fail("\n".join(found), pytrace=False)
