"""Tests of files that do not contain plans. A message of one line states what the file is, where the fault is, and what
the user can do."""

from __future__ import annotations

import io
import pickle
import zipfile
from pathlib import Path

import numpy as np
import openpyxl
import pytest

import petmjx
from petmjx.common.errors import InputError
from petmjx.common.toml_files import read_toml
from petmjx.packers.sample_plans import pack_orders
from petmjx.plans.articles import read_articles
from petmjx.plans.file_formats import number_hint
from petmjx.plans.order_reader import read_orders

COLUMNS = ("plan_id", "sequence", "article", "x_mm", "y_mm", "z_mm", "length_mm", "width_mm", "height_mm", "weight_kg")


def workbook() -> bytes:
    content = io.BytesIO()
    openpyxl.Workbook().save(content)
    return content.getvalue()


def archive(*names: str) -> bytes:
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w") as written:
        for name in names:
            written.writestr(name, "x")
    return content.getvalue()


def array() -> bytes:
    content = io.BytesIO()
    np.save(content, np.zeros((3, 4)))
    return content.getvalue()


def arrays() -> bytes:
    content = io.BytesIO()
    np.savez(content, a=np.zeros(3))
    return content.getvalue()


def sheet_with_damaged_content() -> bytes:
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w") as file:
        file.writestr("mimetype", "application/vnd.oasis.opendocument.spreadsheet")
        file.writestr("content.xml", "<a/>", zipfile.ZIP_DEFLATED)
    data = bytearray(content.getvalue())
    data[data.index(b"content.xml") + len(b"content.xml")] ^= 0xFF
    return bytes(data)


def table(delimiter: str = ",", **cells: str) -> str:
    row = dict(zip(COLUMNS, ("a", "1", "base", "0", "0", "0", "600", "400", "250", "12"), strict=True)) | cells
    return f"{delimiter.join(COLUMNS)}\n{delimiter.join(row.values())}\n"


KINDS = {
    "workbook.xlsx": (workbook(), "is a workbook without a table of boxes"),
    "workbook.csv": (workbook(), "is a workbook without a table of boxes"),
    "workbook.json": (workbook(), "is a workbook without a table of boxes"),
    "old.xls": (b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1" + bytes(99), "is an Excel workbook of the old kind (.xls): "),
    "sheet.ods": (archive("mimetypeapplication/vnd.oasis.opendocument.spreadsheet"), "is not a whole workbook (.ods)"),
    "damaged.ods": (sheet_with_damaged_content(), "is not a whole workbook (.ods)"),
    "a.npy": (array(), "holds no array of boxes, whose shape must be (n, 6 to 64); the file has array (3, 4)"),
    "a.npz": (arrays(), "holds no array of boxes, whose shape must be (n, 6 to 64); the file has a (3,)"),
    "a.zip": (archive("plans.json"), "is a ZIP archive: unpack it"),
    "a.pkl": (pickle.dumps([1]), "is a Python pickle, which is never read"),
    "scene.xml": (
        b'<?xml version="1.0"?>\n<mujoco/>',
        "is a MuJoCo scene in which no free body consists of exactly one box",
    ),
    "bare.xml": (b"\n <mujoco model='x'/>", "is a MuJoCo scene in which no free body"),
    "page.csv": (b"<!DOCTYPE html><html>", "is a web page (HTML)"),
    "words.txt": (b"hello\nworld\n", "is text, but petmjx finds neither"),
    "plans.csv": (b'{\n "a": []}', "is JSON, but is read as JSON only if its name ends in .json"),
    "x.bin": (bytes(range(256)), "is no text: plans are JSON, or tables in CSV or Parquet"),
    "x.bz2": (b"BZh91AY", "is packed with bzip2: unpack it, or pack it with gzip"),
    "x.pdf": (b"%PDF-1.7", "is a PDF document"),
    "x.db": (b"SQLite format 3\0" + bytes(99), "is an SQLite database"),
}


MIXED = {
    "one group": ("1.200", "write 1200 or 1,200, whichever is meant"),
    "a decimal point": ("1.5", "other numbers of this file have decimal commas; write 1,5"),
    "several groups": ("1.234.567", "it has marks between its thousands; write 1234567"),
}


@pytest.mark.parametrize("name", MIXED)
def test_points_beside_decimal_commas_are_refused(name: str, tmp_path: Path) -> None:
    """Numbers with points are refused if the file also has numbers with decimal commas, even in another row and column.
    If the file has no comma, a point is a decimal point."""
    number, message = MIXED[name]
    rows = table(";", x_mm=number), table(";", plan_id="b", weight_kg="5,5").split("\n")[1]
    (tmp_path / "plans.csv").write_text("".join(rows))
    plan_set = petmjx.load_plans(tmp_path / "plans.csv")
    (skipped,) = plan_set.skipped
    assert f'plan a, row 2: x_mm must be a number, got "{number}"' in skipped.message
    assert message in skipped.message
    assert [plan.plan_id for plan in plan_set.plans] == ["b"]
    file = tmp_path / "articles.csv"
    file.write_text(f"article;strength_n;com_height_mm\na;{number};0\nb;400;-1,5\n")
    with pytest.raises(InputError, match="row 2: strength_n must be a number") as refused:
        read_articles(file)
    assert message in str(refused.value)
    if number.count(".") == 1:
        (tmp_path / "plans.csv").write_text(table(";", x_mm=number, article="1,5"))
        (plan,) = petmjx.load_plans(tmp_path / "plans.csv").plans
        assert plan.corner_mm[0, 0] == float(number)
        file.write_text(f"article;strength_n\na,5;{number}\n")
        strength = read_articles(file).by_article["a,5"].strength
        assert strength is not None
        assert strength.strength_n == float(number)


def test_workbooks_and_tables_in_place_of_other_files(tmp_path: Path) -> None:
    for name in ("book.xlsx", "book.toml", "book.parquet"):
        (tmp_path / name).write_bytes(workbook())
    for name, message in (("book.xlsx", "save the sheet as CSV"), ("book.parquet", "save "), ("book.toml", "not TOML")):
        with pytest.raises(InputError, match=rf"{name}: is an Excel workbook \(.xlsx\).*{message}"):
            read_articles(tmp_path / name)
    with pytest.raises(InputError, match=r"book.xlsx: is an Excel workbook \(.xlsx\), not TOML"):
        read_toml(tmp_path / "book.xlsx")
    (tmp_path / "p.csv").write_text("id;n\na;1\n")
    with pytest.raises(InputError, match=r"p.csv: lacks the sizes of items; there are id, n"):
        list(read_orders(tmp_path / "p.csv"))
    (tmp_path / "a.csv").write_text('{"articles": {}}')
    with pytest.raises(InputError, match="is JSON, but a table of articles must be TOML, CSV or Parquet"):
        read_articles(tmp_path / "a.csv")


@pytest.mark.parametrize("name", KINDS)
def test_other_kinds_are_named(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    content, message = KINDS[name]
    Path(name).write_bytes(content)
    plan_set = petmjx.load_plans(name)
    (skipped,) = plan_set.skipped
    assert not plan_set.plans
    assert skipped.message.startswith(f"{name}: {message}")
    assert skipped.message.isprintable()
    with pytest.raises(InputError, match=f"^{name}: "):
        list(pack_orders(Path(name)))


MESSAGES = {
    "header": (
        table().replace("article", "L\u00e4nge").encode("cp1252"),
        'row 2: L\u00e4nge must be a number, got "base"',
    ),
    "cell": (
        table(article="K\u00e4se").encode("cp1252"),
        'plan a, row 2: article is not UTF-8 text ("K\u00e4se" in Windows-1252): save the file as UTF-8',
    ),
    "no cp1252 either": (
        table(article="K@se").encode().replace(b"@", b"\x81"),
        "plan a, row 2: article is not UTF-8 text: save the file as UTF-8",
    ),
    "decimal comma": (
        table(length_mm='"400,0"').encode(),
        'plan a, row 2: length_mm must be a number, got "400,0": it has a decimal comma; write 400.0, or separate',
    ),
    "thousands with semicolons": (
        table(";", length_mm="1.200,5").encode(),
        'plan a, row 2: length_mm must be a number, got "1.200,5": it has marks between its thousands; write 1200.5',
    ),
    "thousands": (
        table(x_mm='"1,200.5"').encode(),
        'plan a, row 2: x_mm must be a number, got "1,200.5": it has marks between its thousands; write 1200.5',
    ),
    "either": (table(z_mm='"1,200"').encode(), 'row 2: z_mm must be a number, got "1,200": write 1200 or 1.200'),
}


@pytest.mark.parametrize("name", MESSAGES)
def test_what_other_programs_write_is_named_with_its_place(name: str, tmp_path: Path) -> None:
    content, message = MESSAGES[name]
    (tmp_path / "plans.csv").write_bytes(content)
    (skipped,) = petmjx.load_plans(tmp_path / "plans.csv").skipped
    assert message in skipped.message
    assert "\\ud" not in skipped.message


OWN = {
    "table.txt": table().encode(),
    "table.dat": b"sep=;\n" + table(";").encode(),
    "table.json": table().encode(),
    "mark.csv": b"sep=;\r\n" + table(";").encode(),
    "quoted.csv": b'"sep=,"\n' + table().encode(),
}


@pytest.mark.parametrize("name", OWN)
def test_petmjx_s_own_table_is_read_under_any_name_and_mark(name: str, tmp_path: Path) -> None:
    (tmp_path / name).write_bytes(OWN[name])
    with pytest.warns(petmjx.PlanWarning, match="read as petmjx's table; mm, kg; coordinates of corners; z upwards"):
        (plan,) = petmjx.load_plans(tmp_path / name).plans
    assert (plan.plan_id, plan.articles, plan.size_mm.tolist()) == ("a", ("base",), [[600.0, 400.0, 250.0]])


def test_utf_16_is_read_as_utf_8(tmp_path: Path) -> None:
    (tmp_path / "p.csv").write_bytes(table().encode("utf-16"))
    (plan,) = petmjx.load_plans(tmp_path / "p.csv").plans
    assert plan.plan_id == "a"


def test_json_in_another_encoding(tmp_path: Path) -> None:
    item = '"article": "K\u00e4se", "id": "1", "length/mm": 400, "width/mm": 300, "height/mm": 200, "weight/kg": 5'
    place = f'[{{"item": {{{item}, "sequence": 1}}, "orientation": 0, "flb_coordinates": [0, 0, 0]}}]'
    (tmp_path / "p.json").write_bytes(f'{{"a": {place}, "K\u00e4se": {place}}}'.encode("cp1252"))
    first, second = (skipped.message for skipped in petmjx.load_plans(tmp_path / "p.json").skipped)
    assert 'plan a, placement 0: article is not UTF-8 text ("K\u00e4se" in Windows-1252): save' in first
    assert 'plan K\\xe4se: the plan id is not UTF-8 text ("K\u00e4se" in Windows-1252): save' in second


def test_articles_too(tmp_path: Path) -> None:
    file = tmp_path / "a.csv"
    cases = [
        (b"sep=;\narticle;strength_n\nx;1\n", 'row 1: "sep=;" is Excel\'s mark'),
        (
            "article,strength_n\nx,1\nK\u00e4se,2\n".encode("cp1252"),
            'row 3 is not UTF-8 text \\("K\u00e4se,2" in Windows',
        ),
        (b'article,strength_n\nx,"400,5"\n', "row 2: strength_n must be a number .* decimal comma; write 400.5"),
        (workbook(), "is an Excel workbook"),
    ]
    for content, message in cases:
        file.write_bytes(content)
        with pytest.raises(InputError, match=message):
            read_articles(file)


NUMBERS = {
    "400,0": "400.0",
    "-1.234.567,8": "-1234567.8",
    "1'200.5": "1200.5",
    "1 200": "1200",
    "1\u202f200,5": "1200.5",
    ",5": ".5",
    "9" * 10_000 + ",5": "9" * 10_000 + ".5",
    **dict.fromkeys(("1,2,3", "1.2", "abc", "12,34,567", ""), ""),
}


@pytest.mark.parametrize(("text", "written"), NUMBERS.items(), ids=lambda text: text[:12])
def test_how_a_number_is_to_be_written(text: str, written: str) -> None:
    hint = number_hint(text)
    assert (f"write {written}" in hint) if written else hint == ""
