"""One command for each module of this package that has a `command`."""

from importlib import import_module
from pathlib import Path

import click


@click.group(context_settings={"help_option_names": ["-h", "--help"]})
def main() -> None:
    """Search for faults: random files, random scenes, kills at random moments."""


for file in sorted(Path(__file__).parent.glob("[!_]*.py")):
    module = import_module(f"tests.search.{file.stem}")
    if hasattr(module, "command"):
        main.add_command(module.command, name=file.stem)

if __name__ == "__main__":
    main(prog_name="python -m tests.search")
