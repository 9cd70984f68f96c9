"""A user's mistake, told in one line: what, where, what to do. The command line prints it and exits with status 2."""

from __future__ import annotations


class InputError(Exception):
    """A call or a file is wrong. ``where`` names the file (and row or key), ``fix`` the next action."""

    def __init__(self, what: str, where: str = "", fix: str = "") -> None:
        self.what, self.where, self.fix = one_line(what), one_line(where), one_line(fix)
        head = f"{self.where}: {self.what}" if where else self.what
        super().__init__(f"{head}; {self.fix}" if fix else head)


def one_line(text: str) -> str:
    """Without line breaks and what is indented after them: a library's words, or a cell of somebody's table."""
    return " ".join(part for line in text.splitlines() if (part := line.strip()))


def in_words(error: BaseException) -> str:
    """What an error says, in one line, or its kind where it says nothing."""
    return one_line(str(error)) or type(error).__name__
