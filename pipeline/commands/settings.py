"""puddle settings: every setting of a study."""

from pipeline.commands.options import StudyOptions, with_options
from pipeline.commands.terminal import to_stdout
from pipeline.config.annotated import annotated_lines


@with_options
def settings(options: StudyOptions) -> None:
    """Print every setting with its unit, reason and value.

    The text is a file to start your own from.
    """
    to_stdout(*annotated_lines(options.settings(to_compute=False)))
