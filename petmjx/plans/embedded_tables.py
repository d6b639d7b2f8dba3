"""Reads tables in texts that have more than the table: INSERT and COPY statements of SQL dumps, and LaTeX."""

from __future__ import annotations

import csv
import re
from collections.abc import Mapping
from typing import Final

from petmjx.common.errors import InputError
from petmjx.common.text import printable_name

_INSERT: Final = re.compile(
    r"^[ \t]{0,99}INSERT\s{1,9}(?:IGNORE\s{1,9})?INTO\s{1,9}([\w.`\"\[\]]{1,200})\s{0,9}"
    r"(?:\(([^()]{1,9999})\))?\s{0,9}VALUES\b",
    re.IGNORECASE | re.MULTILINE,
)
_CHANGE: Final = re.compile(
    r"^[ \t]{0,99}(?:UPDATE|DELETE\s{1,9}FROM|REPLACE\s{1,9}INTO)\s", re.IGNORECASE | re.MULTILINE
)
"""A statement that changes rows that were inserted before."""
_COPY: Final = re.compile(
    r"^COPY\s{1,9}([\w.\"]{1,200})\s{0,9}\(([^()]{1,9999})\)\s{1,9}FROM\s{1,9}stdin;", re.MULTILINE
)
_CREATE: Final = re.compile(r"\bCREATE\s{1,9}TABLE\b[^(;]{0,300}?([\w.`\"\[\]]{1,200})\s{0,9}\(", re.IGNORECASE)
_ROW: Final = re.compile(r"[\s,]{0,99}\(((?:'(?:[^'\\]|''|\\.)*+'|[^'()])*+)\)")
"""The values of a row: "(1,'A (large)',0,0,0)". The quantifiers are possessive, so that the time of a search grows only
linearly with the text, even for malicious texts."""
_LINE_END: Final = re.compile(r"\s{0,99}\n\s{0,99}")
_QUOTES: Final = '`"[] \t\r\n'
_NOT_COLUMNS: Final = frozenset(("PRIMARY", "UNIQUE", "KEY", "INDEX", "CONSTRAINT", "FOREIGN", "CHECK"))


def rows_of_sql(text: str) -> dict[str, list[list[str]]]:
    """Name of a table → its rows in a dump of a database. The first row of a table has the names of its columns. The
    result is empty if the text has no rows of tables.

    Raises:
        InputError: the names of the columns of a table are missing, or a row is damaged.
    """
    tables: dict[str, list[list[str]]] = {}
    bodies: dict[str, int] = {}
    if _INSERT.search(text) is not None:  # find the places at which CREATE TABLE lists the columns of each table
        bodies = {create[1].strip(_QUOTES): create.end() for create in _CREATE.finditer(text)}
    for insert in _INSERT.finditer(text):
        rows = _table_of(tables, insert, text, bodies)
        at = insert.end()
        while (row := _ROW.match(text, at)) is not None:
            line = _LINE_END.sub(" ", row[1])
            values = next(csv.reader([line], quotechar="'", escapechar="\\", skipinitialspace=True), [])
            rows.append(["" if value.strip().upper() == "NULL" else value for value in values])
            at = row.end()
        if text[at : at + 99].lstrip()[:1] not in ("", ";") and not text[at : at + 99].lstrip().startswith("ON "):
            raise InputError(f"line {text.count(chr(10), 0, at) + 1}: not a row of values")
    if tables and (change := _CHANGE.search(text)) is not None:
        number = text.count("\n", 0, change.end()) + 1
        raise InputError(f"line {number}: rows are changed after they were inserted; export the table instead")
    for copy in _COPY.finditer(text):
        rows = _table_of(tables, copy, text, bodies)
        if (end := text.find("\n\\.", copy.end())) < 0:
            raise InputError(f"line {text.count(chr(10), 0, copy.end()) + 1}: the rows have no end; truncated?")
        for line in text[copy.end() : end].splitlines()[1:]:
            rows.append(["" if value == "\\N" else value for value in line.split("\t")])
    return {name: rows for name, rows in tables.items() if len(rows) > 1}


def _table_of(
    tables: dict[str, list[list[str]]], statement: re.Match[str], text: str, bodies: Mapping[str, int]
) -> list[list[str]]:
    """The table that a statement names, as the list of the rows that have been read so far. A new table has one row,
    with the names of its columns. ``bodies``: name of a table → position of the list of columns in its CREATE TABLE."""
    name = statement[1].strip(_QUOTES)
    if name not in tables:
        columns = statement[2].split(",") if statement[2] else _created_columns(text, bodies.get(name, len(text)))
        if not columns:
            raise InputError(f"the names of the columns of {printable_name(name)} are missing")
        tables[name] = [[column.strip(_QUOTES) for column in columns]]
    return tables[name]


def _created_columns(text: str, begin: int) -> list[str]:
    """The names of the columns in the statement that creates a table."""
    end = text.find(";", begin)
    body = re.sub(r"\([^()]*\)", "", text[begin : end if end > 0 else len(text)][:_LONGEST_CREATE])
    first_words = [column.split()[0].strip(_QUOTES) for column in body.split(",") if column.strip()]
    return [word for word in first_words if word.upper() not in _NOT_COLUMNS]


_LONGEST_CREATE: Final = 100_000
"""Largest number of characters of a CREATE TABLE statement that are searched for the names of columns."""
_TABULAR: Final = re.compile(r"\\begin\{(?:tabular[xy*]?|longtable|array|tblr)\}")
_SPAN: Final = re.compile(r"\\multicolumn\{(\d{1,2})\}\{[^{}]{0,99}\}\{([^{}]{0,999})\}")
_MARKED: Final = re.compile(
    r"\\(?:textbf|textit|emph|texttt|text|mathrm|num|makecell|multirow\{\d+\}\{[^{}]*\})\{([^{}]*)\}"
)
_COMMAND: Final = re.compile(r"\\[a-zA-Z]+\*?(?:\[[^\]\n]{0,99}\]|\([^)\n]{0,99}\)|\{[^{}\n]{0,99}\})*")
_END: Final = re.compile(r"\\\\(?:\[[^\]\n]{0,99}\])?")
"""The end of a row in LaTeX: two backslashes, possibly with the space below the row in brackets."""
_COMMENT: Final = re.compile(r"(?<!\\)%.*")
_ESCAPED: Final = re.compile(r"\\([_%&#$])")
_AMPERSAND: Final = "\ue002"


def text_of_latex(text: str) -> str:
    """The rows of the tables in a LaTeX text, with "&" between fields; all other lines are empty. The result is "" if
    the text has no table."""
    if _TABULAR.search(text) is None:
        return ""
    lines = []
    for line in text.split("\n"):
        line = _COMMENT.sub("", line)
        line = _ESCAPED.sub(lambda mark: _AMPERSAND if mark[1] == "&" else mark[1], _END.sub("\n", line))
        line = _SPAN.sub(lambda span: span[2] + " &" * (int(span[1]) - 1), line)
        line = _COMMAND.sub(" ", _MARKED.sub(r"\1", line)).strip()
        lines.append(re.sub(r"[${}]", "", line.replace("~", " ")) if "&" in line else "")
    return "\n".join(lines).replace(_AMPERSAND, "and")
