"""Docstrings as the reference shows them: a field's comment is its own, and what Sphinx would link is plain code."""

import re

from griffe import Attribute, Docstring, Extension, Object


class Comments(Extension):
    """Changes what griffe reads from the sources."""

    def on_attribute_instance(self, *, attr: Attribute, **_: object) -> None:
        """Take the comment beside a field."""
        if attr.docstring is None and (found := re.search(r"  # (.*)$", "".join(attr.lines[:1]))):
            attr.docstring = Docstring(found[1], parent=attr)

    def on_object(self, *, obj: Object, **_: object) -> None:
        """Turn reStructuredText into Markdown."""
        if obj.docstring is not None:
            plain = re.sub(r":(class|func|meth|mod):", "", obj.docstring.value)
            obj.docstring.value = plain.replace("::\n", ":\n").replace("``", "`")
