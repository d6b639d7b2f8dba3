"""Columns with the rotations of boxes in other tools' tables (``turns_of``): numbers, degrees, letters and words;
and the rotation matrices of poses."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from petmjx.common.text import printable_name
from petmjx.common.units import FloatArray
from petmjx.plans.cell_numbers import NO_WORDS, YES_WORDS, cell_number, cell_text
from petmjx.plans.column_names import word_set, words_of


@dataclass(frozen=True, eq=False)
class Turns:
    """A column with the rotations of boxes.

    Attributes:
        column: name of the column.
        rules: names of the rules that are possible with its values (``readings.ROTATION_RULES``).
        codes: (n,) number of each rotation: 0 to 5 as in py3dbp, or the number of quarter turns; −1: unknown.
        letters: (n, 3) the size that lies along each axis, if rotations are written as letters; None: rotations are not
            written as letters.
        words: the two words for rotations 0 and 1, or all words if ``rules`` is empty; empty if the cells have numbers
            or words of known meaning.
        guess_cost: cost of a reading with these rotations if the name of the column is unknown, so that only the cells
            suggest rotations; 0: the name is known.
        faults: row → fault of its cell, if the name of the column is unknown. The faults count only if the cells are
            rotations (``may_be_ignored``).
    """

    column: str
    rules: tuple[str, ...]
    codes: NDArray[np.int64]
    letters: NDArray[np.int64] | None = None
    words: tuple[str, ...] = ()
    guess_cost: float = 0.0
    faults: Mapping[int, str] = field(default_factory=dict)

    def may_be_ignored(self, rule: str) -> bool:
        """Whether a reading with this rule shows that the cells are no rotations: the rule turns no box, although
        cells say that boxes are turned."""
        return rule == "none" and bool((np.maximum(self.codes, 0) % 2 == 1).any())


def turns_of(
    name: str, cells: Sequence[Any], decimal: str, on_fault: Callable[[int, str], None], guess_cost: float = 0.0
) -> Turns | None:
    """The rotations in a column; None if the column is empty.

    If the cells have two words of unknown meaning, either word may stand for a turned box. If the cells have more than
    two words of unknown meaning, no rule of rotation is possible (``Turns.rules`` is empty), unless the further words
    may be damaged cells (``_DAMAGED_SHARE``). A blank cell means that the box is not turned, unless another cell says
    this with a number or a word.

    Args:
        name: name of the column.
        decimal: decimal sign of numbers stored as text.
        on_fault: function that is called with the row and the fault of each bad cell.
        guess_cost: as in :class:`Turns`.
    """
    filled_cells = [cell for cell in cells if cell not in (None, "")]
    if not filled_cells:
        return None
    cells = _with_yes_and_no(cells)
    letters = [letters_of(cell) for cell in cells]
    if sum(order is not None for order in letters) * 2 > len(filled_cells):
        codes, array = np.full(len(cells), -1, np.int64), np.zeros((len(cells), 3), np.int64)
        for row, order in enumerate(letters):
            if order is None:
                on_fault(row, _shown_turn(cells[row], "three letters"))
            else:
                array[row], codes[row] = order, 0
        return Turns(name, ("letters",), codes, array)
    values = _in_degrees([_turn_number(cell, decimal) for cell in cells])
    is_blank = [cell in (None, "") for cell in cells]
    if any(value == 0 and not blank for value, blank in zip(values, is_blank, strict=True)):
        values = [None if blank else value for value, blank in zip(values, is_blank, strict=True)]
    integers = {value for value in values if value is not None and float(value).is_integer()}
    n_quarters = sum(value is not None and value % 90 == 0 for value in values)
    in_degrees = any(abs(value) > 5 and value % 90 == 0 for value in integers)
    in_degrees &= n_quarters >= sum(value in (0, 1) for value in values)
    turns: list[int | None]
    if in_degrees or name.lower() in ("yaw", "angle", "winkel"):
        rules: tuple[str, ...] = ("degrees",)
        kind = "a multiple of 90 degrees"
        turns = [None if value is None or value % 90 else int(value // 90) % 4 for value in values]
    else:
        words_of_name = set(words_of(name))
        if words_of_name & _QUARTERS:
            rules, kind, allowed = ("swap",), "0 to 3", range(4)
        elif max(integers, default=0) <= 1 or words_of_name & _TURNED or guess_cost:
            rules, kind, allowed = ("swap", "py3dbp"), f"0 or 1, or {_EXAMPLES}", range(2)
        elif 0 in integers or max(integers) <= 5:
            from_1 = () if 0 in integers else ("py3dbp from 1", "permutations from 1")
            rules, kind, allowed = ("py3dbp", "permutations", *from_1), "0 to 5", range(6)
        else:
            rules, kind, allowed = ("py3dbp from 1", "permutations from 1"), "1 to 6", range(1, 7)
        turns = [int(value) if value is not None and value in allowed else None for value in values]
    if sum(turn is not None for turn in turns) * 2 <= len(filled_cells):
        texts = [cell_text(cell) for cell in cells]
        words = _words_in(texts)
        if len(words) == 2:
            for row, text in enumerate(texts):
                if text not in words:
                    on_fault(row, _shown_turn(cells[row], " or ".join(words)))
        rules = ("swap", "swap back") if len(words) == 2 else ()
        codes = np.array([text == words[-1] for text in texts], np.int64)
        return Turns(name, rules, codes, words=words, guess_cost=guess_cost) if len(words) > 1 else None
    for row, turn in enumerate(turns):
        if turn is None:
            on_fault(row, _shown_turn(cells[row], kind))
    codes = np.array([-1 if turn is None else turn for turn in turns], np.int64)
    return Turns(name, rules, codes, guess_cost=guess_cost)


_EXAMPLES: Final = "a word such as yes, no, true, false, rotated, turned, x or none"
"""Words that may stand in a column of rotations, for messages."""
_QUARTERS: Final = word_set("quarter quarters quarterturn quarterturns")
_TURNED: Final = word_set(
    "rotated turned swapped flipped gedreht gedr verdreht tourne girado girada ruotato ruotata obrocony gedraaid "
    "rotacionado rotacionada virado virada rodado rodada girato girata volteado volteada otoceno otoceni elforgatas"
)
"""Words in names of columns of rotations whose cells are numbers of quarter turns (``_QUARTERS``), or yes and no
(``_TURNED``)."""
_DAMAGED_SHARE: Final = 0.05
"""Largest share of damaged cells of a column, if all other cells have one of only two words (such as yes and no)."""


def _words_in(texts: Sequence[str]) -> tuple[str, ...]:
    """The words of a column, sorted: the two most frequent ones if the others may be damaged, else all."""
    counts = Counter(texts).most_common()
    n_others = sum(count for _, count in counts[2:])
    return tuple(sorted(word for word, _ in (counts[:2] if n_others <= _DAMAGED_SHARE * len(texts) else counts)))


def are_yes_or_no(cells: Sequence[Any]) -> bool:
    """Whether cells mean yes or no, and both occur. One cell may have any other text, since it may be damaged."""
    texts = Counter(cell_text(cell).lower() for cell in cells)
    n_yes, n_no = (sum(texts[word] for word in words) for words in (_YES, _NO))
    has_words = any(text in _YES | _NO and text not in ("", "-", "0", "1", "x", "none", "original") for text in texts)
    return has_words and min(n_yes, n_no) > 0 and n_yes + n_no >= max(2, len(cells) - 1)


def are_two_values(cells: Sequence[Any]) -> bool:
    """Whether a column has two different values: 0 and 1, or two words. Each of the two must occur several times. A few
    cells may be damaged."""
    texts = [cell_text(cell) for cell in cells]
    words = _words_in(texts)
    are_words = not any(cell_number(word) for word in words) and "" not in words
    return len(words) == 2 and (words == ("0", "1") or are_words) and min(map(texts.count, words)) > 1


def may_be_turns(cells: Sequence[Any]) -> bool:
    """Whether cells are yes or no, or are quarter turns in degrees (0, 90, 180, 270 or −90), some of them 0 and some
    not. One cell may have any other value, since it may be damaged."""
    numbers = [None if number is None else number.value for number in map(cell_number, cells)]
    n_turned, n_unturned = sum(number in (90, 180, 270, -90) for number in numbers), numbers.count(0)
    return are_yes_or_no(cells) or (min(n_turned, n_unturned) > 0 and n_turned + n_unturned >= max(2, len(cells) - 1))


def letters_of(cell: Any) -> tuple[int, int, int] | None:
    """For three letters such as "YXZ" or "WLH": the index of the size along x, y and z. The result is None if the
    letters name no orientation."""
    text = cell_text(cell).upper().removeprefix("ROTATIONTYPE.").removeprefix("RT_").removeprefix("ORIENTATION.")
    for letters in ("XYZ", "LWH", "WHD", "LBH", "LHD", "WDH", "ABC"):
        if sorted(text) == sorted(letters):
            return letters.index(text[0]), letters.index(text[1]), letters.index(text[2])
    return None


_YES: Final = YES_WORDS | {"rotated", "turned", "gedreht", "x"}
_NO: Final = NO_WORDS | {"original", "none", "", "-"}


_YES_AND_NO: Final = tuple(map(frozenset, ("sn", "on", "tn", "vf", "tf", "wf")))
"""Initials of yes and no, or true and false, in Spanish, Portuguese and Italian (S and N, V and F), French (O and N),
Polish (T and N), English (T and F) and German (W and F)."""


def _with_yes_and_no(cells: Sequence[Any]) -> Sequence[Any]:
    """The cells, with letters for yes and no (or true and false) replaced by True and False. If the texts of the cells
    are not exactly one of the pairs of letters in ``_YES_AND_NO``, the cells are returned unchanged."""
    texts = {cell_text(cell).lower() for cell in cells}
    if texts not in _YES_AND_NO:
        return cells
    return [cell_text(cell).lower() not in ("n", "f") for cell in cells]


def _turn_number(cell: Any, decimal: str) -> float | None:
    if isinstance(cell, bool):
        return float(cell)
    number = cell_number(re.sub(r"\s*(°|deg|degrees|grad)$", "", cell) if isinstance(cell, str) else cell, decimal)
    if number is not None and np.isfinite(number.value):
        return number.value
    text = cell_text(cell).lower()
    return 1.0 if text in _YES else 0.0 if text in _NO else None


def angles_of(columns: Sequence[Sequence[Any]], decimal: str) -> FloatArray:
    """(n, k) angles in degrees, from the cells of k columns; NaN for cells without a number."""
    values = [_turn_number(cell, decimal) for cells in columns for cell in cells]
    angles = np.array([np.nan if value is None else value for value in _in_degrees(values)])
    return angles.reshape(len(columns), -1).T


def rotations_of_angles(angles: FloatArray) -> list[FloatArray]:
    """Two arrays (n, 3, 3) of rotation matrices, from (n, 3) angles about x, y and z, in degrees. The first array is
    for turns in the order x, y, z, the second array for turns in the order z, y, x. Only one array is returned if both
    are equal except for signs."""
    about = []
    for axis in range(3):
        cos, sin = np.cos(np.radians(angles[:, axis])), np.sin(np.radians(angles[:, axis]))
        matrix = np.zeros((len(angles), 3, 3))
        first, second = (axis + 1) % 3, (axis + 2) % 3
        matrix[:, axis, axis] = 1.0
        matrix[:, first, first] = matrix[:, second, second] = cos
        matrix[:, first, second], matrix[:, second, first] = -sin, sin
        about.append(matrix)
    x, y, z = about
    both = [z @ y @ x, x @ y @ z]
    return both[:1] if np.allclose(np.abs(both[0]), np.abs(both[1]), equal_nan=True) else both


def _in_degrees(values: list[float | None]) -> list[float | None]:
    """Angles in radians as degrees. Quarter turns become whole multiples of 90 degrees. Numbers that are not in radians
    are unchanged.

    Numbers are radians if some are not whole, none is more than a whole turn, and some are above ``_LEVEL_RAD``, so
    that they turn a box. So a box that is turned by 1.5 radians counts as crooked, and not as nearly unturned.
    """
    numbers = [value for value in values if value is not None]
    turned = any(abs(value) > _LEVEL_RAD for value in numbers)
    if not turned or max(map(abs, numbers)) > _MOST_RAD or all(float(value).is_integer() for value in numbers):
        return values
    return [None if value is None else _degrees(value) for value in values]


def _degrees(angle_rad: float) -> float:
    quarters = angle_rad / (math.pi / 2)
    return 90.0 * (round(quarters) if abs(quarters - round(quarters)) < _NEAR_QUARTER else quarters)


_NEAR_QUARTER: Final = 5e-3
"""An angle in radians counts as a whole number of quarter turns if it differs from this number by at most this share of
a quarter turn. The share is above 0, since numbers such as 1.57 have only three digits."""

_LEVEL_RAD: Final = 0.1
"""Angles up to this value do not turn a box, whether they are in radians or in degrees: boxes that have settled are
never exactly level."""

_MOST_RAD: Final = 2 * math.pi + 0.01
"""Largest angle in radians: a whole turn, which may be rounded up."""


def _shown_turn(cell: Any, kind: str) -> str:
    return "is missing" if cell in (None, "") else f'must be {kind}, got "{printable_name(cell_text(cell))}"'


# Matrices.


def tilt(rotation: FloatArray) -> FloatArray:
    """(n,) how far each of the rotations (n, 3, 3) is from right angles: 1 minus the cosine of the angle between an
    axis of the box and the nearest coordinate axis, for the axis with the largest angle."""
    largest: FloatArray = np.abs(np.abs(rotation).max(axis=2) - 1).max(axis=1)
    return largest


def is_rotation(cell: Any) -> bool:
    """Whether a cell is a rotation matrix, (3, 3)."""
    return (
        isinstance(cell, list | tuple) and [len(row) if isinstance(row, list | tuple) else 0 for row in cell] == [3] * 3
    )


def is_matrix(cell: Any) -> bool:
    """Whether a cell is the matrix of a pose."""
    return isinstance(cell, list | tuple) and matrix_of(cell) is not None


def matrix_of(cell: Any) -> FloatArray | None:
    """The matrix of a pose, (4, 4) or (3, 4), in a cell; None if there is none. A matrix that is listed column by
    column (three.js, USD) is transposed."""
    try:
        array = np.asarray(cell, dtype=float)
    except (TypeError, ValueError):
        return None
    if array.shape == (16,):
        array = array.reshape(4, 4)
    if array.shape == (4, 4) and _ends(array.T) and not _ends(array):
        array = array.T
    return array if array.shape in ((4, 4), (3, 4)) and np.isfinite(array).all() else None


def _ends(matrix: FloatArray) -> bool:
    """Whether the last row of a (4, 4) matrix is 0, 0, 0, 1."""
    return bool((matrix[3] == (0, 0, 0, 1)).all())


def bad_member(cell: Any) -> str:
    """The end of a message about a bad matrix: the text that stands in place of the matrix, or the first member that is
    not a number, with its index from 0. The result is "" if only the shape of the matrix is wrong."""
    if isinstance(cell, str):
        return f', got "{printable_name(cell)}"'
    flat = [value for row in cell for value in (row if isinstance(row, list | tuple) else (row,))] if cell else []
    for index, value in enumerate(flat):
        number = cell_number(value)
        if number is None or not np.isfinite(number.value):
            return f", got {printable_name(str(value))} as number {index}"
    return ""


def rotations_of_quaternions(quaternion: FloatArray) -> FloatArray:
    """(n, 3, 3) rotation matrices of (n, 4) quaternions w, x, y, z."""
    with np.errstate(invalid="ignore"):
        w, x, y, z = (quaternion / np.linalg.norm(quaternion, axis=1, keepdims=True)).T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), 2, 0)
