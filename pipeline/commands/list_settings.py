"""puddle settings: every setting with its unit, its reason and its value, or the schema for an editor."""

from typing import Annotated

import typer

from pipeline.commands.options import StudyOptions, print_json, with_options
from pipeline.commands.output import to_stdout


@with_options
def list_settings(
    options: StudyOptions,
    schema: Annotated[
        bool, typer.Option("--schema", help="Print the JSON schema of settings files, for an editor.")
    ] = False,
) -> None:
    """Print every setting with its unit, its reason and its value, as a file to start your own from.

    Editors check and complete a settings file by the schema: save it as puddle.schema.json, and begin the file with
    `# yaml-language-server: $schema=puddle.schema.json`.
    """
    from pipeline.config.annotated import annotated_lines, json_schema

    if schema:
        print_json(json_schema())
        return
    for line in annotated_lines(options.settings()):
        to_stdout(line)
