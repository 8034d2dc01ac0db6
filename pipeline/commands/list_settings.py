"""puddle settings: every setting with its unit, its reason and its value."""

import typer

from pipeline.commands.options import StudyOptions, with_options


@with_options
def list_settings(options: StudyOptions) -> None:
    """Print every setting with its unit, its reason and its value, as a file to start your own from."""
    from pipeline.config.annotated import annotated_lines

    for line in annotated_lines(options.settings()):
        typer.echo(line)
