"""The folder of `puddle export`: champions, tables, figures and a LaTeX table of a study, for use outside puddle.

::

    export.json                     what made the folder, the settings, the progress, and the SHA-256 of every file
    settings.yaml                   the study's settings, for `puddle study --settings`
    champions/ARM-trial-N.json      a design file for each champion; ARM-trial-N-adapted.json: with adapted controller
    champions/ARM-trial-N.xml       the same as a model of MuJoCo, where it was asked for
    tables/NAME.parquet             as study.tables names them
    tables/columns.csv              what every table holds, and unit and meaning of its columns
    figures/NAME.svg, .png, .pdf    five inches wide
    figures/captions.txt            what each figure shows
    transfer.tex                    the transfer results
    results.json                    means and deviations of every arm, champions, accuracy, times and digests
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from itertools import chain
from pathlib import Path

import pyarrow.parquet as pq
import yaml

from pipeline.errors import PuddleError
from pipeline.report.page import draw_all
from pipeline.report.render import ColumnNote, as_csv, as_latex
from pipeline.results.recorded_study import Study
from pipeline.results.results_json import results_of
from pipeline.results.study_tables import about
from pipeline.stages.files import ADAPTED, CHAMPION
from pipeline.stages.report import REPORT, read_page
from pipeline.store import disk
from pipeline.store.encoding import Json
from pipeline.store.owned_folder import FolderKind, NewFolder
from pipeline.store.provenance import environment as provenance
from pipeline.workflow.identity import trials_of
from tasks.analysis.columns import scored_by
from tasks.analysis.tables.transfer import TransferRow
from tasks.simulation.mjcf import mjcf as as_mjcf

EXPORT = FolderKind("an export", "puddle.export", 1, "export.json")

LARGE_TABLES = ("histories", "adaptations")  # of every design that ever lived; gigabytes in a large study


def export_study(study: Study, out: Path, *, tables: Sequence[str] | None = None, mjcf: bool = False) -> list[str]:
    """Write the folder, or nothing.

    Args:
        study: the study.
        out: the folder: a new one, an empty one, or an earlier export, which is replaced.
        tables: names of the tables to write; if there are none, all of the study's but ``LARGE_TABLES``.
        mjcf: whether to write champions as models of MuJoCo, too.

    Returns:
        Lines that say what was written, what was preserved and what is missing.

    Raises:
        PuddleError: the folder is somebody else's or can't be written, the study has no results yet or not such a
            table, or an item of the store is damaged.
    """
    place = EXPORT.check_place(out)
    if place.is_relative_to(study.store.root):
        raise PuddleError(f"{out}: expected a folder outside the store {study.store.root}. Choose another with --out.")
    if not study.tables:
        raise PuddleError(f"study {study.name}: none of its work is done yet, so there is nothing to export")
    chosen = list(dict.fromkeys(tables or (name for name in study.tables if name not in LARGE_TABLES)))
    if unknown := [name for name in chosen if name not in study.tables]:
        raise PuddleError(
            f"study {study.name} has no table {', '.join(unknown)}. Expected --table to be one of "
            f"{', '.join(study.tables)}."
        )
    settings = study.settings.model_dump(mode="json")
    progress: dict[str, Json] = {name: vars(counts) for name, counts in study.progress.items()}
    manifest: dict[str, Json] = {"study": study.name, "settings": settings, "progress": progress}
    with EXPORT.replace(place, {**manifest, "made_with": provenance()}) as folder:
        folder.write("settings.yaml", yaml.safe_dump(settings, sort_keys=False).encode())
        page = read_page(study.settings, study.upstream, study.store)
        results = json.dumps(results_of(study, page), indent=1, ensure_ascii=False)
        folder.write("results.json", results.encode() + b"\n")
        kind, rows = scored_by(study.settings.evolution.maximised, TransferRow), page.rows("transfer")
        caption, learners = f"Transfer results of study {study.name}.", study.settings.arm_learners
        folder.write("transfer.tex", as_latex(kind, rows, caption, learners).encode())
        n_champions = _write_champions(study, folder, mjcf)
        n_rows = _write_tables(study, chosen, folder)
        drawings = draw_all(page)
        for drawing in drawings.values():
            for suffix, content in (("svg", drawing.svg), ("png", drawing.png), ("pdf", drawing.pdf)):
                folder.write(f"figures/{drawing.name}.{suffix}", content)
        captions = "\n".join(f"{drawing.name}: {drawing.description}\n" for drawing in drawings.values())
        folder.write("figures/captions.txt", captions.encode())
    lines = [
        f"{name}: {counts.missing} work items are missing and {counts.failed} failed; the export lacks them."
        for name, counts in study.progress.items()
        if name != REPORT.name and (counts.missing or counts.failed)  # the export draws its own figures
    ]
    wrote = f"{n_champions} champions, {len(chosen)} tables of {n_rows:,} rows, {len(drawings)} figures, transfer.tex"
    return [*folder.preserved, *lines, f"study {study.name}: {wrote}: {place}"]


def _write_champions(study: Study, folder: NewFolder, mjcf: bool) -> int:
    """Write the design of every champion, as it evolved and with its adapted controller; return their number."""
    n_champions = 0
    for trial in trials_of(study.settings, "transfer"):
        files = study.reader.champion_files(trial)
        for file, suffix in ((CHAMPION, ""), (ADAPTED, "-adapted")):
            if file in files:
                name = f"champions/{trial.environment}-{trial.depth:g}m-trial-{trial.index}{suffix}"
                folder.write(f"{name}.json", files[file])
                if mjcf:
                    design = study.reader.design(trial, file)
                    folder.write(f"{name}.xml", as_mjcf(design, trial.depth, study.settings.physics).encode())
                n_champions += file == CHAMPION
    return n_champions


def _write_tables(study: Study, tables: Sequence[str], folder: NewFolder) -> int:
    """Write tables, and the list of what they and their columns hold; return the number of rows."""
    n_rows, notes = 0, list[ColumnNote]()
    for name in tables:
        path, parts = folder.place(f"tables/{name}.parquet"), study.parts(name)  # which may exceed the memory
        first = next(parts)
        with disk.named(path), pq.ParquetWriter(path, first.schema, compression="zstd") as writer:
            for part in chain((first,), parts):
                writer.write_table(part)
                n_rows += len(part)
        disk.fsync(path)
        notes.append(ColumnNote(name, "", "", about(name)))
        for column in first.schema:
            unit, meaning, label = (column.metadata.get(word, b"").decode() for word in (b"unit", b"meaning", b"label"))
            notes.append(ColumnNote(name, column.name, unit, meaning or label))
    folder.write("tables/columns.csv", as_csv(ColumnNote, notes))
    return n_rows
