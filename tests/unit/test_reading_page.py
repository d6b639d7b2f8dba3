"""The page that shows how a file was read."""

from __future__ import annotations

from pathlib import Path

import pytest

from petmjx.cli.main import main

TABLE = """Nr;Artikel;Farbe;L [cm];B [cm];H [cm];X [cm];Y [cm];Z [cm];Gewicht [kg]
1;<b>Kiste</b>;rot;60;40;30;0;0;0;12,5
2;Karton;rot;60;40;30;0;40;0;12,5
3;Karton;rot;60;40;20;0;20;30;8
"""


def test_the_page_has_a_picture_the_columns_and_the_numbers(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file, page = tmp_path / "ladung.csv", tmp_path / "ladung.html"
    file.write_text(TABLE, encoding="cp1252")
    assert main(["info", str(file), "--html", str(page)]) == 0
    assert "page: " in capsys.readouterr().err
    text = page.read_text(encoding="utf-8")
    assert text.count("<svg") == 1
    for shown in (
        "L [cm]",
        "Gewicht [kg]",
        "600, 400, 300",
        "0, 200, 300",
        "12.5",
        "decimal commas",
        "Not used: Farbe",
    ):
        assert shown in text
    assert "<b>Kiste" not in text, "texts of files are no markup"
    assert "&lt;b&gt;Kiste" in text
    before = page.read_bytes()
    assert main(["info", str(file), "--html", str(page)]) == 2, "nothing is replaced without asking"
    assert page.read_bytes() == before
