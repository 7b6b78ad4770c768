"""On which line of a TOML text each key stands, which tomllib does not tell.

The text is one that tomllib has accepted, so the scanner only has to keep its place: it steps over strings, comments
and values and writes down the line of each header and key, by its path in the parsed data: `("cuts", 1, "air_s")`.
"""

import re
import tomllib

Loc = tuple[str | int, ...]

_BARE = re.compile(r"[A-Za-z0-9_-]+")
_STRING = re.compile(r'"""(?:\\.|[^\\])*?"{3,5}|\'\'\'.*?\'{3,5}|"(?:\\.|[^"\\\n])*"|\'[^\'\n]*\'', re.DOTALL)
_SCALAR = re.compile(r"[^,\]}#\n]+")
_BLANK = re.compile(r"(?:[ \t\r\n]|#[^\n]*)*")


def locate(text: str) -> dict[Loc, int]:
    """Line, from 1, of every table header, key and array item in a valid TOML text; of a repeated table, the first."""
    return _Scanner(text).scan()


class _Scanner:
    """One walk over a text: `at` is where it stands, `table` the path of the table it is in."""

    def __init__(self, text: str) -> None:
        self.text, self.at, self.table = text, 0, ()
        self.places: dict[Loc, int] = {}
        self.arrays: dict[Loc, int] = {}  # how many times the header [[path]] was met

    def scan(self) -> dict[Loc, int]:
        self._step(_BLANK)
        while self.at < len(self.text):
            if self.text.startswith("[[", self.at):
                self._header(repeated=True)
            elif self.text[self.at] == "[":
                self._header(repeated=False)
            else:
                self._pair(self.table)
            self._step(_BLANK)
        return self.places

    def _step(self, pattern: re.Pattern) -> str:
        match = pattern.match(self.text, self.at)
        self.at = match.end() if match else self.at
        return match.group() if match else ""

    def _note(self, path: Loc) -> None:
        self.places.setdefault(path, self.text.count("\n", 0, self.at) + 1)

    def _key(self) -> tuple[str, ...]:
        """A dotted key, bare or quoted parts, with the blanks around it."""
        parts = []
        while True:
            self._step(_BLANK)
            quoted = self._step(_STRING)
            parts.append(tomllib.loads(f"x = {quoted}")["x"] if quoted else self._step(_BARE))
            self._step(_BLANK)
            if self.text[self.at] != ".":
                return tuple(parts)
            self.at += 1

    def _header(self, repeated: bool) -> None:
        start = self.at
        self.at += 2 if repeated else 1
        *parents, last = self._key()
        path: Loc = ()
        for part in parents:  # a parent that is an array of tables means its newest table
            path = self._newest((*path, part))
        path = (*path, last)
        end, self.at = self.at, start
        self._note(path)
        if repeated:
            self.arrays[path] = self.arrays.get(path, 0) + 1
            path = self._newest(path)
            self._note(path)
        self.at = end + (2 if repeated else 1)
        self.table = path

    def _newest(self, path: Loc) -> Loc:
        return (*path, self.arrays[path] - 1) if path in self.arrays else path

    def _pair(self, table: Loc) -> None:
        path = table
        start = self.at
        key = self._key()
        end, self.at = self.at, start
        for part in key:
            path = (*path, part)
            self._note(path)
        self.at = end + 1  # over the =
        self._value(path)

    def _value(self, path: Loc) -> None:
        self._step(_BLANK)
        opening = self.text[self.at]
        if opening == "[":
            self._items(path, "]")
        elif opening == "{":
            self._items(path, "}")
        elif not self._step(_STRING):
            self._step(_SCALAR)

    def _items(self, path: Loc, closing: str) -> None:
        """The items of an array, or the pairs of an inline table."""
        self.at += 1
        number = 0
        self._step(_BLANK)
        while self.text[self.at] != closing:
            if closing == "]":
                self._note((*path, number))
                self._value((*path, number))
            else:
                self._pair(path)
            number += 1
            self._step(_BLANK)
            if self.text[self.at] == ",":
                self.at += 1
                self._step(_BLANK)
        self.at += 1
