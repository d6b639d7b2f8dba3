"""Tables of other tools: separators, encodings, decimal signs, headers below titles, units, workbooks."""

from __future__ import annotations

import io
import zipfile

import openpyxl
import pytest

from petmjx.common.errors import InputError
from petmjx.plans.cell_numbers import cell_number, cell_triple
from petmjx.plans.column_names import column_meanings
from petmjx.plans.workbooks import read_raw_tables

HEADERS = {
    "English": ("Length (cm)", "Width (cm)", "Height (cm)", "Weight (kg)", "X", "Y", "Z", "Box", "Pallet"),
    "German": ("Länge [cm]", "Breite [cm]", "Höhe [cm]", "Gewicht [kg]", "X", "Y", "Z", "Packstück", "Palette"),
    "French": (
        "Longueur (cm)",
        "Largeur (cm)",
        "Hauteur (cm)",
        "Poids (kg)",
        "Position X",
        "Y",
        "Z",
        "Colis",
        "Palette",
    ),
    "Spanish": ("Largo cm", "Ancho cm", "Alto cm", "Peso kg", "Posición X", "Y", "Z", "Caja", "Palé"),
    "Italian": (
        "Lunghezza_cm",
        "Larghezza_cm",
        "Altezza_cm",
        "Peso_kg",
        "Pos. X",
        "Pos. Y",
        "Pos. Z",
        "Collo",
        "Pallet",
    ),
    "Polish": ("Długość/cm", "Szerokość/cm", "Wysokość/cm", "Waga/kg", "Pozycja X", "Y", "Z", "Karton", "Paleta"),
}
MEANINGS = [
    *(("size", axis, "cm") for axis in ("length", "width", "height")),
    ("weight", "", "kg"),
    *(("position", axis, "") for axis in "xyz"),
    ("item_id", "", ""),
    ("plan", "", ""),
]


@pytest.mark.parametrize("language", HEADERS)
def test_headers_in_six_languages_have_the_same_meanings(language: str) -> None:
    meanings = column_meanings(HEADERS[language])
    assert [meaning and (meaning.kind, meaning.axis, meaning.unit) for meaning in meanings] == MEANINGS


@pytest.mark.parametrize(
    ("names", "axes"),
    [
        (("L", "B", "H"), ("length", "width", "height")),
        (("B", "H", "T"), ("width", "height", "depth")),
        (("L", "l", "H"), ("length", "width", "height")),
        (("dx", "dy", "dz"), ("x", "y", "z")),
        (("WHD[0]", "WHD[1]", "WHD[2]"), ("width", "height", "depth")),
        (("dimensions.width", "dimensions.depth", "dimensions.height"), ("width", "depth", "height")),
    ],
)
def test_axes_of_sizes_are_read_from_words_letters_and_paths(names: tuple[str, ...], axes: tuple[str, ...]) -> None:
    assert [meaning and meaning.axis for meaning in column_meanings(names)] == list(axes)


def test_masse_is_a_weight_and_masze_are_sizes() -> None:
    mass, sizes = column_meanings(["Masse", "Maße (LxBxH) [mm]"])
    assert mass is not None
    assert mass.kind == "weight"
    assert sizes is not None
    assert (sizes.kind, sizes.order, sizes.unit) == ("sizes", ("length", "width", "height"), "mm")


@pytest.mark.parametrize(
    ("cell", "decimal", "value"),
    [
        ("6,5", ",", 6.5),
        ("1.234,5", ",", 1234.5),
        ("1 200,5", ",", 1200.5),
        ("1'200.5", ".", 1200.5),
        ("Decimal('600.0')", ",", 600.0),
        ("12,5 cm", ",", 12.5),
        ("1.200", ",", None),  # either 1200 or 1.2
        ("1,200", "", None),
        ("4O0", ".", None),
        ("1_000", ".", None),
    ],
)
def test_a_cell_is_a_number_only_if_it_can_be_no_other(cell: str, decimal: str, value: float | None) -> None:
    number = cell_number(cell, decimal)
    assert (number and number.value) == value


def test_three_numbers_in_a_cell() -> None:
    for cell in (
        "400x300x200",
        "(400, 300, 200)",
        "[Decimal('400.0'), 300, 200]",
        "L=400 B=300 H=200",
        "400 / 300 / 200",
    ):
        triple = cell_triple(cell)
        assert triple is not None, cell
        assert [number.value for number in triple] == [400, 300, 200], cell


SHEET = [
    ["Packliste 17"],
    [],
    ["Nr", "Länge", "Breite", "Höhe", "Gewicht", "X", "Y", "Z"],
    [None, "mm", "mm", "mm", "kg", "mm", "mm", "mm"],
    [1, 400, 300, 200, 6.5, 0, 0, 0],
    [2, 400, 300, 200.5, 6.5, 0, 0, 200],
    ["Summe", None, None, None, 13, None, None, None],
]
NAMES = ("Nr", "Länge [mm]", "Breite [mm]", "Höhe [mm]", "Gewicht [kg]", "X [mm]", "Y [mm]", "Z [mm]")


def text(delimiter: str, decimal: str) -> str:
    lines = [delimiter.join("" if cell is None else str(cell).replace(".", decimal) for cell in row) for row in SHEET]
    return "\n".join(lines) + "\n"


def xlsx() -> bytes:
    book, content = openpyxl.Workbook(), io.BytesIO()
    for row in SHEET:
        book.active.append(row)
    book.save(content)
    return content.getvalue()


def ods() -> bytes:
    def cell(value: object) -> str:
        if value is None:
            return "<table:table-cell/>"
        kind = "string" if isinstance(value, str) else "float"
        number = "" if isinstance(value, str) else f' office:value="{value}"'
        return f'<table:table-cell office:value-type="{kind}"{number}><text:p>{value}</text:p></table:table-cell>'

    rows = "".join(f"<table:table-row>{''.join(map(cell, row)) or cell(None)}</table:table-row>" for row in SHEET)
    spaces = " ".join(
        f'xmlns:{name}="urn:oasis:names:tc:opendocument:xmlns:{name}:1.0"' for name in ("office", "table", "text")
    )
    body = f'<office:body><office:spreadsheet><table:table table:name="A">{rows}</table:table>'
    body += "</office:spreadsheet></office:body>"
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w") as archive:
        archive.writestr("mimetype", "application/vnd.oasis.opendocument.spreadsheet")
        archive.writestr("content.xml", f"<office:document-content {spaces}>{body}</office:document-content>")
    return content.getvalue()


FILES = {
    "semicolons": text(";", ",").encode(),
    "sep": ("sep=;\n" + text(";", ",")).encode("cp1252"),
    "tabs": text("\t", ",").encode("utf-16"),
    "commas": ("\ufeff" + text(",", ".")).encode(),
    "bars": text("|", ".").encode("cp1252"),
    "xlsx": xlsx(),
    "ods": ods(),
}


@pytest.mark.parametrize("name", FILES)
def test_a_sheet_with_title_units_and_total_is_the_same_table_in_every_form(name: str) -> None:
    (table,), _ = read_raw_tables(FILES[name])
    assert table.header == NAMES
    numbers = [[cell_number(cell, table.decimal) for cell in row] for row in table.rows]
    assert [[number and number.value for number in row] for row in numbers] == SHEET[4:6]
    shift = 1 if name == "sep" else 0
    assert table.places == [f"row {5 + shift}", f"row {6 + shift}"]


def test_polish_of_windows_1250_is_told_from_windows_1252() -> None:
    (table,), _ = read_raw_tables("Lp.;Długość;Szerokość;Wysokość;X;Y;Z\n1;4;3;2;0;0;0\n".encode("cp1250"))
    assert table.header[1] == "Długość"
    assert "Windows-1250" in table.notes


def test_lines_between_rows_name_parts() -> None:
    data = "Nr;L;B;H;X;Y;Z\nPalette A\n1;4;3;2;0;0;0\nPalette B\n2;4;3;2;0;0;0\n3;4;3;2;0;0\n"
    (first, second), _ = read_raw_tables(data.encode())
    assert (first.part, first.places, second.part, second.places) == ("Palette A", ["row 3"], "Palette B", ["row 5"])
    assert first.lost == (("row 6", "has 6 fields instead of 7"),)


@pytest.mark.parametrize("name", ["xlsx", "ods"])
def test_a_cut_workbook_is_refused(name: str) -> None:
    with pytest.raises(InputError, match="is not a whole workbook"):
        read_raw_tables(FILES[name][:400])
