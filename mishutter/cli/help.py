"""The text of `--help`: options and commands in groups that say what they are for.

Typer groups in boxes alone, in which long names are cut; here groups are plain text.
"""

from typing import Any, final

from typer.core import TyperCommand, TyperGroup

DESIGN = "What to design"
MOVES = "What may move"
SEARCH = "The search"
SENSOR = "The sensor"
CAMERA = "A camera that exists"
PICTURES = "Photographs"
OUTPUT = "Output"
TABLE = "The drive table"
MAP = "The map"

_ORDER = (DESIGN, MOVES, MAP, SEARCH, CAMERA, PICTURES, SENSOR, TABLE, OUTPUT)

TO_DESIGN = "Design"
TO_BUILD = "Build"
TO_SEE = "See"
TO_BEGIN = "Begin"


@final
class GroupedCommand(TyperCommand):
    """A command whose options are listed by the groups that they name."""

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write arguments and options, those without a group at the end."""
        found: dict[str, list[Any]] = {name: [] for name in ("Arguments", *_ORDER, "Options")}
        for parameter in self.get_params(ctx):
            record = parameter.get_help_record(ctx)
            if record is not None:
                kind = "Arguments" if parameter.param_type_name == "argument" else "Options"
                found[getattr(parameter, "rich_help_panel", None) or kind].append(record)
        _write(formatter, found)


@final
class GroupedCommands(TyperGroup):
    """All commands, listed by the groups that they name."""

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write the commands, each with its first sentence."""
        found: dict[str, list[Any]] = {name: [] for name in (TO_DESIGN, TO_SEE, TO_BUILD, TO_BEGIN)}
        for name in self.list_commands(ctx):
            command: Any = self.get_command(ctx, name)
            sentence = " ".join(command.help.partition("\n\n")[0].split())
            found[command.rich_help_panel].append((name, sentence))
        _write(formatter, found)


def _write(formatter: Any, groups: dict[str, list[Any]]) -> None:
    for title, records in groups.items():
        if records:
            with formatter.section(title):
                formatter.write_dl(records)
