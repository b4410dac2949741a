"""The text of `--help`: options and commands in groups by their purpose.

Typer draws groups only as boxes, which cut long names; these are plain text.
"""

from typing import TYPE_CHECKING, Any, final

from typer.core import TyperCommand, TyperGroup

if TYPE_CHECKING:
    from typer._click.formatting import HelpFormatter

Groups = dict[str, list[tuple[str, str]]]
"""Names of options or commands and their help, by the title of their group."""

DESIGN = "Designs and losses"
MOVES = "Parts to search for"
SEARCH = "Search"
SENSOR = "Sensor"
CAMERA = "Camera as built"
PICTURES = "Photographs"
OUTPUT = "Output"
TABLE = "Drive table"
MAP = "Map"

TO_DESIGN = "Design"
TO_BUILD = "Build"
TO_SEE = "See"
TO_BEGIN = "Begin"


@final
class GroupedCommand(TyperCommand):
    """A command whose help lists options by group."""

    def format_options(self, ctx: Any, formatter: "HelpFormatter") -> None:
        """Writes arguments and options, those without a group at the end."""
        order = (DESIGN, MOVES, MAP, SEARCH, CAMERA, PICTURES, SENSOR, TABLE, OUTPUT)
        groups: Groups = {name: [] for name in ("Arguments", *order, "Options")}
        for parameter in self.get_params(ctx):
            record = parameter.get_help_record(ctx)
            if record is not None:
                record = record[0].partition(" <")[0], record[1]  # without a name of Python's type
                kind = "Arguments" if parameter.param_type_name == "argument" else "Options"
                groups[getattr(parameter, "rich_help_panel", None) or kind].append(record)
        _write(formatter, groups)


@final
class GroupedCommands(TyperGroup):
    """The program, whose help lists commands by group."""

    def format_commands(self, ctx: Any, formatter: "HelpFormatter") -> None:
        """Writes the commands, each with its first sentence."""
        groups: Groups = {name: [] for name in (TO_BEGIN, TO_DESIGN, TO_SEE, TO_BUILD)}
        for name in self.list_commands(ctx):
            command = self.get_command(ctx, name)
            if isinstance(command, GroupedCommand) and command.help:
                sentence = " ".join(command.help.partition("\n\n")[0].split())
                groups[command.rich_help_panel or TO_BEGIN].append((name, sentence))
        _write(formatter, groups)


def _write(formatter: "HelpFormatter", groups: Groups) -> None:
    for title, records in groups.items():
        if records:
            with formatter.section(title):
                formatter.write_dl(records)
