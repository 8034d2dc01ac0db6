"""Pages that are not files of docs/: the README, what lies beside it, and the reference of what users import."""

from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

import puddle

ROOT = Path(__file__).parents[2]
PAGES = {"README.md": "index.md", "CONTRIBUTING.md": "CONTRIBUTING.md", "CHANGELOG.md": "CHANGELOG.md"}
LINKED = ("LICENSE", "NOTICE", "CITATION.cff", "benchmarks/results.json", "configs/paper.yaml")
RETURNED = (
    "pipeline.results.recorded_study.Study",
    "tasks.simulation.rollout.Rollouts",
    "tasks.residual.ensemble.Ensemble",
    "tasks.residual.throws.Transitions",
)


def on_files(files: Files, config: MkDocsConfig) -> None:
    """Add the pages, and files that pages link to."""
    names = [f"puddle.{name}" for name in sorted(puddle.__all__, key=str.swapcase) if name != "GENES"]
    summary = puddle.__doc__.partition("\n")[2].replace("::\n", ":\n").replace(":class:", "")
    reference = "\n\n".join(f"::: {name}" for name in (*names, *RETURNED))
    files.append(File.generated(config, "api.md", content=f"# API reference\n{summary}\n{reference}\n"))
    for name, page in PAGES.items():
        files.append(File.generated(config, page, content=(ROOT / name).read_text()))
    for name in LINKED:
        files.append(File.generated(config, name, abs_src_path=str(ROOT / name)))


def on_page_markdown(markdown: str, page: Page, **_: object) -> str:
    """Put what lies in docs/ and what lies beside it in one folder."""
    if "/" in page.file.src_uri:
        return markdown
    return markdown.replace("](docs/", "](").replace("](../", "](").replace("](README.md", "](index.md")
