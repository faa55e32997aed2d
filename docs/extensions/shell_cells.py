"""`%%bash` cells of the site: what they print is one piece of plain text, and an error ends the build.

IPython's own `%%bash` gives the output in pieces of a hundred characters, between which myst-nb breaks the line.
"""

from __future__ import annotations

import os
import subprocess

from IPython.core.interactiveshell import InteractiveShell

_COLOURFUL = ("FORCE_COLOR", "CLICOLOR", "CLICOLOR_FORCE")  # which a kernel sets for all that runs below it


def bash(line: str, cell: str) -> None:
    """Run a cell by bash and print what it says.

    Raises:
        CalledProcessError: a command of it failed.
    """
    plain = {name: value for name, value in os.environ.items() if name not in _COLOURFUL}
    plain |= {"TERM": "dumb", "COLUMNS": "80", "PYTHONUNBUFFERED": "1"}
    command = ["bash", "-e", "-c", cell]
    done = subprocess.run(command, env=plain, text=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
    print(done.stdout, end="")
    done.check_returncode()


def load_ipython_extension(shell: InteractiveShell) -> None:
    """Called by `%load_ext`."""
    shell.register_magic_function(bash, "cell")
