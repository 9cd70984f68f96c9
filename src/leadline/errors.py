"""A user's mistake, told in one line: what, where, what to do. The command line prints it and exits with status 2."""

from __future__ import annotations


class InputError(Exception):
    """A call or a file is wrong. ``where`` names the file (and row or key), ``fix`` the next action."""

    def __init__(self, what: str, where: str = "", fix: str = "") -> None:
        self.what, self.where, self.fix = what, where, fix
        head = f"{where}: {what}" if where else what
        super().__init__(f"{head}; {fix}" if fix else head)
