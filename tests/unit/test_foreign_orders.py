"""Tests of orders in files of other tools: tables of items in any locale, test problems of packing research, lists in
JSON, and plans."""

from __future__ import annotations

import json
import os
import re
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import openpyxl
import pandas as pd
import pytest
from support.command_line import run

import petmjx
from petmjx.common.errors import InputError, PlanWarning
from petmjx.loop.episode_orders import Orders, order_reading
from petmjx.options.run_options import RunOptions
from petmjx.packers.pack import orders_of, reading_of
from petmjx.packers.sample_plans import pack_orders
from petmjx.plans.item_units_and_quantities import OrderReading
from petmjx.plans.masses_and_densities import SET_KG_M3, USUAL_KG_M3
from petmjx.plans.order import Order, target_extent_mm, target_named
from petmjx.plans.order_reader import keep_orders, read_orders

Boxes = list[tuple[float, float, float, float]]

SMALL = (400.0, 300.0, 200.0, 6.5)
LARGE = (600.0, 400.0, 250.0, 12.0)


def read(path: Path, note: str = "read as", **options: object) -> dict[str, Order]:
    """The orders of a file. There must be a note that states how the file was read."""
    target = options.pop("target", None)
    assert target is None or isinstance(target, str)
    with pytest.warns(PlanWarning, match=note):
        return dict(read_orders(path, reading=OrderReading.of(RunOptions(**options), target)))


def boxes_of(order: Order) -> Boxes:
    return [(item.length_mm, item.width_mm, item.height_mm, item.weight_kg) for item in order.items]


def near(order: Order, boxes: Boxes) -> bool:
    return np.asarray(boxes_of(order)).shape == (len(boxes), 4) and np.allclose(boxes_of(order), boxes, rtol=1e-12)


def sheet(path: Path, rows: list[tuple[object, ...]]) -> None:
    book = openpyxl.Workbook()
    for row in rows:
        book.active.append(row)
    book.save(path)


TABLES: dict[str, tuple[str, str]] = {
    "english": ("utf-8", "Product,Length (cm),Width (cm),Height (cm),Weight (kg),Qty\n"
                "s,40,30,20,6.5,2\nl,60,40,25,12,1\n"),
    "german": (
        "cp1252",
        "Artikel;Länge [mm];Breite [mm];Höhe [mm];Stückgewicht (kg);Anzahl\ns;400;300;200;6,5;2\nl;600;400;250;12;1\n",
    ),
    "french": ("utf-16", "Référence\tLongueur (m)\tLargeur (m)\tHauteur (m)\tPoids (g)\tQuantité\n"
               "s\t0,40\t0,30\t0,20\t6500\t2\nl\t0,60\t0,40\t0,25\t12000\t1\n"),
    "spanish": ("utf-8", "sep=;\nSKU;Largo;Ancho;Alto;Peso;Cantidad\ns;40;30;20;6,5;2\nl;60;40;25;12;1\n"),
    "italian": ("utf-8", "Articolo|Lunghezza (cm)|Larghezza (cm)|Altezza (cm)|Peso (kg)|Quantità\n"
                "s|40|30|20|6,5|2\nl|60|40|25|12|1\n"),
    "polish": ("cp1250", "Towar;Długość [cm];Szerokość [cm];Wysokość [cm];Waga [kg];Ilość\n"
               "s;40;30;20;6,5;2\nl;60;40;25;12;1\n"),
    "rows' weights": ("utf-8", "name,L,B,H,Gesamtgewicht,Kartons\ns,400,300,200,13,2\nl,600,400,250,12,1\n"),
    "sizes in a cell": ("utf-8", "sku,dimensions,weight_kg,qty\ns,40x30x20 cm,6.5,2\nl,60x40x25 cm,12,1\n"),
    "layers": ("utf-8", "name,length,width,height,weight,boxes per layer,layers\n"
               "s,400,300,200,6.5,1,2\nl,600,400,250,12,1,1\n"),
    "titles": ("utf-8", "Packliste 17\n\nname,length,width,height,weight,qty\ns,400,300,200,6.5,2\nl,600,400,250,12,1\n"
               "total,,,,,3\n"),
    "pieces in cells": ("utf-8", "Item;Size;Unit weight;Ordered\ns;400 x 300 x 200 mm;6.5 kg;2 pcs\n"
                        "l;600 x 400 x 250 mm;12 kg;1 pcs\n"),
    "spaces in names alone": ("utf-8", "Item #,Case Length (cm),Case Width (cm),Case Height (cm),Case Weight (kg),"
                              "Cases Ordered\ns,40,30,20,6.5,2\nl,60,40,25,12,1\n"),
    "compounds": ("utf-8", "Artikelnummer;Kartonlänge cm;Kartonbreite cm;Kartonhöhe cm;Kartongewicht kg;Kartons\n"
                  "s;40;30;20;6,5;2\nl;60;40;25;12;1\n"),
    "columns of units": ("utf-8", "sku,length,width,height,dim_unit,weight,weight_unit,qty\n"
                         "s,40,30,20,cm,6500,g,2\nl,60,40,25,cm,12000,g,1\n"),
    "pieces in boxes": ("utf-8", "SKU,Cajas,Uds/caja,Largo caja (mm),Ancho caja (mm),Alto caja (mm),Peso caja (kg)\n"
                        "s,2,12,400,300,200,6.5\nl,1,6,600,400,250,12\n"),
    "German words in one": ("utf-8", "Pos.;Material;Länge;Breite;Höhe;DimE;Bruttogewicht;GewE;Liefermenge\n"
                            "10;l;60,0;40,0;25,0;CM;12;KG;1,000\n20;s;40,0;30,0;20,0;CM;6,5;KG;2,000\n"),
    "commas in a cell": ("utf-8", "Réf.;Dim. colis LxlxH (cm);Poids unit. (kg);Qté\ns;40,0 x 30,0 x 20,0;6,5;2\n"
                         "l;60,0 x 40,0 x 25,0;12,0;1\n"),
    "a title of two cells": ("utf-8", "Order 88,,,,Ship to: Reno NV\n"
                             "SKU,L (in),W (in),H (in),Case wt (lbs),Cases ordered\n"
                             "s,15.748,11.811,7.874,14.33005,2\nl,23.622,15.748,9.8425,26.45547,1\n"),
    "grams": ("utf-8", '[{"sku": "s", "grams": 6500, "quantity": 2, "dimensions": {"length": 40, "width": 30, '
              '"height": 20, "unit": "cm"}}, {"sku": "l", "grams": 12000, "quantity": 1, '
              '"dimensions": {"length": 60, "width": 40, "height": 25, "unit": "cm"}}]'),
    "YAML": ("utf-8", "items:\n- {name: s, length: 40, width: 30, height: 20, weight: 6.5, quantity: 2}\n"
             "- {name: l, length: 60, width: 40, height: 25, weight: 12, quantity: 1}\n"),
    "names in rows": ("utf-8", "SKU,s,l\nLength mm,400,600\nWidth mm,300,400\nHeight mm,200,250\nWeight kg,6.5,12\n"
                      "Qty,2,1\n"),
    "a web page": ("utf-8", "<table><tr><td>SKU<td>L (cm)<td>W (cm)<td>H (cm)<td>kg/pc<td>Qty</tr><tr><td>s<td>40<td>30"
                   "<td>20<td>6.5<td>2</tr><tr><td>l<td>60<td>40<td>25<td>12<td>1</tr></table>"),
    "XML": ("utf-8", "<Order><Line><SKU>s</SKU><Length>400</Length><Width>300</Width><Height>200</Height><Weight>6.5"
            "</Weight><Qty>2</Qty></Line><Line><SKU>l</SKU><Length>600</Length><Width>400</Width><Height>250</Height>"
            "<Weight>12</Weight><Qty>1</Qty></Line></Order>"),
    "packingsolver": ("utf-8", "X,Y,Z,COPIES,WEIGHT\n400,300,200,2,6.5\n600,400,250,,12\n"),
    "no quantities": ("utf-8", "id,length,width,height,weight\n"
                      "1,400,300,200,6.5\n2,400,300,200,6.5\n3,600,400,250,12\n"),
}  # fmt: skip


@pytest.mark.parametrize("name", TABLES)
def test_tables_of_items_are_orders(name: str, tmp_path: Path) -> None:
    encoding, text = TABLES[name]
    path = tmp_path / "items.csv"
    path.write_bytes(text.encode(encoding))
    (order,) = read(path).values()
    boxes = np.array(sorted(boxes_of(order)))
    np.testing.assert_allclose(boxes, [SMALL, SMALL, LARGE], rtol=1e-5)
    assert order.target == "euro-pallet"


HEADERS: list[str] = [
    "Nr zamówienia;Indeks;Długość (mm);Szerokość (mm);Wysokość (mm);Waga (kg);Sztuk",
    "N° commande;Réf.;Longueur (mm);Largeur (mm);Hauteur (mm);Poids (kg);Nb colis",
    "Nº pedido;Código;Largo (mm);Ancho (mm);Alto (mm);Peso bruto (kg);Uds.",
    "N. ordine;Cod. articolo;Lungh. (mm);Largh. (mm);Alt. (mm);Peso (kg);Q.tà",
    "Auftragsnr.;Material;Länge in mm;Breite in mm;Höhe in mm;Bruttogewicht (kg);Bestellmenge",
    "PO Number;SKU;Case L (mm);Case W (mm);Case H (mm);Unit weight (kg);Cases Ordered",
    "orderId;productId;lengthMm;widthMm;heightMm;weightKg;count",
    "Pallet ID;Box type;Box length [mm];Box width [mm];Box height [mm];Box mass [kg];No. of boxes",
]


@pytest.mark.parametrize("header", HEADERS)
def test_names_of_columns_that_only_orders_have(header: str, tmp_path: Path) -> None:
    rows = "1001;s;400;300;200;6.5;2\n1001;l;600;400;250;12;1\n1002;s;400;300;200;6.5;4\n"
    (tmp_path / "a.csv").write_text(f"{header}\n{rows}", "utf-8")
    orders = read(tmp_path / "a.csv")
    assert list(orders) == ["1001", "1002"]
    assert near(orders["1001"], [SMALL, SMALL, LARGE])
    assert near(orders["1002"], [SMALL] * 4)
    assert [item.article for item in orders["1001"].items] == ["s", "s", "l"]


def test_a_quantity_of_pieces_or_boxes_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("sku,L,B,H,weight (kg),Qty,Units per case\ns,400,300,200,6.5,24,12\nl,600,400,250,12,6,6\n")
    message = "Qty counts boxes, or pieces (Units per case is the number of pieces in a box); if it counts boxes, say"
    with pytest.raises(InputError, match=re.escape(message)):
        dict(read_orders(path))
    (order,) = read(path, columns={"quantity": "Qty"}).values()
    assert near(order, [SMALL] * 24 + [LARGE] * 6)


def test_quantities_that_rise_are_asked_about(tmp_path: Path) -> None:
    """Numbers of an unknown column that rise by equal steps number the rows. Other numbers may be quantities."""
    path = tmp_path / "a.csv"
    rows = [f"{name},{400 + number},300,200,6.5" for number, name in enumerate("stu")]
    for values, refused in (((2, 3, 7), True), ((10, 20, 30), False)):
        path.write_text("\n".join(["sku,L,B,H,weight,Foo", *map("{},{}".format, rows, values)]))
        if refused:
            with pytest.raises(InputError, match="each row is one box, or Foo counts its boxes"):
                dict(read_orders(path))
        else:
            (order,) = read(path).values()
            assert len(order.items) == 3


def test_an_unknown_column_that_may_be_a_quantity_is_refused(tmp_path: Path) -> None:
    """A file is refused if an unknown column may be a quantity. The file is not refused if articles occur in several
    rows, so that each row must be one box."""
    path = tmp_path / "a.csv"
    path.write_text("sku,L,B,H,weight,Foo\ns,400,300,200,6.5,2\nl,600,400,250,12,1\n")
    message = (
        "each row is one box, or Foo counts its boxes; say which with --columns quantity=- or --columns quantity=Foo"
    )
    with pytest.raises(InputError, match=message):
        list(read_orders(path))
    (order,) = read(path, "one box a row; not used: Foo", columns={"quantity": "-"}).values()
    assert near(order, [SMALL, LARGE])
    (order,) = read(path, columns={"quantity": "Foo"}).values()
    assert near(order, [SMALL, SMALL, LARGE])
    path.write_text("sku,L,B,H,weight,Foo\ns,400,300,200,6.5,2\ns,400,300,200,6.5,1\n")
    (order,) = read(path, "one box a row; not used: Foo").values()
    assert near(order, [SMALL, SMALL])


@pytest.mark.parametrize("weight", ["Gewicht", "Gesamtgewicht"])
def test_rows_with_the_quantity_0_are_left_out(weight: str, tmp_path: Path) -> None:
    """Rows with the quantity 0 are left out, whatever is in their other cells. An order needs at least one box."""
    lines = ["A;s;2;400;300;200;6.5", "A;none;0;400;300;200;0", "A;l;1;600;400;250;12", "B;none;0;;300;200;1"]
    if weight == "Gesamtgewicht":
        lines[0] = "A;s;2;400;300;200;13"
    path = tmp_path / "a.csv"
    path.write_text("\n".join([f"Auftrag;Artikel;Menge;L;B;H;{weight}", *lines, ""]), "utf-8")
    refused: list[str] = []
    with pytest.warns(PlanWarning, match="2 rows left out, since Menge is 0: row 3, row 5"):
        orders = dict(read_orders(path, lambda error: refused.append(str(error))))
    assert near(orders["A"], [SMALL, SMALL, LARGE])
    assert refused == [f"{path}: order B: must have at least one item: all quantities are 0"]


RIVALS: dict[str, tuple[str, str, dict[str, str], tuple[int, Boxes]]] = {
    "quantities": (
        "sku,L,B,H,weight,Units,Cases\ns,400,300,200,6.5,12,2\nl,600,400,250,12,7,1\n",
        "the quantity is Units, or Cases; say which with --columns quantity=Units or --columns quantity=Cases",
        {"quantity": "Cases"},
        (3, [SMALL, SMALL, LARGE]),
    ),
    "sizes": (
        "sku,item length,item width,item height,case length,case width,case height,weight\n"
        "s,80,60,40,400,300,200,6.5\nl,90,60,40,600,400,250,12\n",
        "the length is item length, or case length; say which with --columns length=item length",
        {"length": "case length", "width": "case width", "height": "case height"},
        (2, [SMALL, LARGE]),
    ),
}


@pytest.mark.parametrize("name", RIVALS)
def test_two_columns_for_one_role_are_refused(name: str, tmp_path: Path) -> None:
    text, message, columns, (count, boxes) = RIVALS[name]
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(InputError, match=message):
        list(read_orders(tmp_path / "a.csv"))
    (order,) = read(tmp_path / "a.csv", columns=columns).values()
    assert len(order.items) == count
    assert near(order, boxes)


def test_gross_weights_are_taken(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("sku,L,B,H,Nettogewicht,Bruttogewicht\ns,400,300,200,6,6.5\nl,600,400,250,11,12\n")
    (order,) = read(tmp_path / "a.csv", "columns L, B, H, Bruttogewicht").values()
    assert near(order, [SMALL, LARGE])


def test_inches_and_pounds(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("name,length (in),width (in),height (in),weight (lbs),qty\na,16,12,10,20,2\n")
    (order,) = read(tmp_path / "a.csv").values()
    assert near(order, [(406.4, 304.8, 254.0, 9.0718474)] * 2)


def test_sheets_and_several_orders(tmp_path: Path) -> None:
    header = ("Auftrag", "Artikelnr", "L", "B", "H", "Gewicht (kg)", "Menge")
    rows = [("A1", "s", 400, 300, 200, 6.5, 2), ("A2", "l", 600, 400, 250, 12, 1), ("A1", "l", 600, 400, 250, 12, 1)]
    sheet(tmp_path / "a.xlsx", [("Palette 1200 x 1000",), header, *rows])
    orders = read(tmp_path / "a.xlsx", "2 orders, 4 boxes; mm, kg; .*packed on 1200x1000")
    assert list(orders) == ["A1", "A2"]
    assert near(orders["A1"], [SMALL, SMALL, LARGE])
    assert [item.article for item in orders["A1"].items] == ["s", "s", "l"]
    assert target_extent_mm(orders["A2"].target) == (1200.0, 1000.0)


def test_sizes_of_articles_from_another_sheet_or_file(tmp_path: Path) -> None:
    """Sizes of articles may be in another sheet or file. A column "Position" that numbers the rows is not a place."""
    lines = [("Auftrag", "Position", "Artikel", "Menge"), ("A1", 1, "s", 2), ("A1", 2, "l", 1), ("A2", 1, "l", 3)]
    articles = [("Artikel", "Länge [mm]", "Breite [mm]", "Höhe [mm]", "Gewicht [kg]"), ("l", 600, 400, 250, 12)]
    articles.append(("s", 400, 300, 200, 6.5))
    book = openpyxl.Workbook()
    for title, rows in (("Aufträge", lines), ("Artikelstamm", articles)):
        page = book.create_sheet(title)
        for row in rows:
            page.append(row)
    book.save(tmp_path / "both.xlsx")
    sheet(tmp_path / "lines.xlsx", list(lines))
    pd.DataFrame(articles[1:], columns=articles[0]).to_csv(tmp_path / "articles.csv", index=False)
    for orders in (
        read(tmp_path / "both.xlsx", "sizes and weights from the sheet Artikelstamm"),
        read(tmp_path / "lines.xlsx", "sizes and weights from .*articles.csv", items=tmp_path / "articles.csv"),
    ):
        assert near(orders["A1"], [SMALL, SMALL, LARGE])
        assert near(orders["A2"], [LARGE] * 3)
    (tmp_path / "other.csv").write_text("name,length,width,height\nx,1,2,3\ny,1,2,3\n")
    with pytest.raises(InputError, match=r"other.csv: its items do not match the orders"):
        list(read_orders(tmp_path / "lines.xlsx", reading=OrderReading(items=tmp_path / "other.csv")))
    with pytest.raises(InputError, match=r"lines.xlsx: lacks the sizes of items; .*; --items FILE names a file"):
        list(read_orders(tmp_path / "lines.xlsx"))


def test_a_column_called_order_is_a_sequence_or_names_orders(tmp_path: Path) -> None:
    body = "sku,length,width,height,weight\n{}s,400,300,200,6.5\n{}l,600,400,250,12\n{}s,400,300,200,6.5\n"
    (tmp_path / "a.csv").write_text("order," + body.format("2,", "1,", "3,"))
    (order,) = read(tmp_path / "a.csv").values()
    assert near(order, [LARGE, SMALL, SMALL])
    (tmp_path / "b.csv").write_text("order," + body.format("7,", "8,", "7,"))
    orders = read(tmp_path / "b.csv")
    assert {name: len(order.items) for name, order in orders.items()} == {"7": 2, "8": 1}


def test_lists_in_json(tmp_path: Path) -> None:
    item = {"sku": "s", "length": 400, "width": 300, "height": 200, "weight": 6.5, "quantity": 2}
    content = [{"order_id": "o1", "items": [item]}, {"order_id": "o2", "items": [item, {**item, "quantity": 1}]}]
    (tmp_path / "a.json").write_text(json.dumps(content))
    orders = read(tmp_path / "a.json")
    assert {name: boxes_of(order) for name, order in orders.items()} == {"o1": [SMALL] * 2, "o2": [SMALL] * 3}


THPACK = """ 2
 1 2502505
 587 233 220
 2
 1 108 0 76 0 30 1 2
 2 92 1 81 1 55 0 1
 2 2502605
 587 233 220
 1
 1 91 0 54 0 45 1 3
"""


def test_container_loading_problems(tmp_path: Path) -> None:
    """In container loading problems, the height of a box is vertical if this is permitted. If the height may not be
    vertical, the next permitted dimension is vertical."""
    (tmp_path / "thpack1.txt").write_text(THPACK)
    orders = read(
        tmp_path / "thpack1.txt",
        "1 box type lies on a permitted side, since the height must not be vertical.*container, 5,870 × 2,330 mm, is",
    )
    assert list(orders) == ["thpack1-1", "thpack1-2"]
    sizes = [box[:3] for box in boxes_of(orders["thpack1-1"])]
    assert sizes == [(1080, 760, 300), (1080, 760, 300), (920, 550, 810)]
    assert boxes_of(orders["thpack1-1"])[0][3] == pytest.approx(1.08 * 0.76 * 0.3 * USUAL_KG_M3)
    assert len(orders["thpack1-2"].items) == 3
    orders = read(tmp_path / "thpack1.txt", target="5870x2330", density=100)
    assert boxes_of(orders["thpack1-2"])[0] == pytest.approx((910, 540, 450, 0.91 * 0.54 * 0.45 * 100))
    assert orders["thpack1-2"].target == "5870x2330"


def test_problems_with_weights(tmp_path: Path) -> None:
    (tmp_path / "wtpack1.txt").write_text(
        "587 233 220\n1 29.82\n78 1 49 1 47 1 2 179.63 0.195 0.189 0.146\n"
        "587 233 220\n1 9.1\n98 0 44 1 36 0 1 155.2 1 1 1\n"
    )
    orders = read(tmp_path / "wtpack1.txt")
    assert boxes_of(orders["wtpack1-1"]) == [(780, 490, 470, 179.63)] * 2
    assert boxes_of(orders["wtpack1-2"]) == [(980, 360, 440, 155.2)]


BINS: dict[str, tuple[str, str]] = {
    "in one line": ("2 100 100 100\n10 20 30\n50 40 25\n", "cm"),
    "with numbers of boxes": ("2 100 100 100\n1 10 20 30\n2 50 40 25\n", "cm"),
    "in two lines": ("2\n10 10 10\n1 2 3\n5 4 2.5\n", "dm"),
    "bin first": ("100 100 100\n2\n10 20 30\n50 40 25\n", "cm"),
}


@pytest.mark.parametrize("name", BINS)
def test_bin_packing_problems(name: str, tmp_path: Path) -> None:
    """In bin packing problems, sizes are width, height (vertical) and depth. The unit follows from the width of the
    bin: 100 or 10 units are 1 m."""
    text, unit = BINS[name]
    (tmp_path / "mpv.txt").write_text(text)
    (order,) = read(tmp_path / "mpv.txt", f"; {unit}; columns width, depth, height").values()
    assert [box[:3] for box in boxes_of(order)] == [(100, 300, 200), (500, 250, 400)]
    assert order.target == "1000x1000"


def test_robobpp_sets(tmp_path: Path) -> None:
    (tmp_path / "opai.txt").write_text("62 35.5 13\n" * 60)
    orders = read(tmp_path / "opai.txt", "; cm;")
    assert {name: len(order.items) for name, order in orders.items()} == {"opai-1": 50, "opai-2": 10}
    assert boxes_of(orders["opai-2"])[0] == pytest.approx((620, 355, 130, 0.62 * 0.355 * 0.13 * SET_KG_M3))
    header = ("Pallet No", "Length_cm", "Width_cm", "Height_cm", "Gross weight", "Pick_quantity_cs")
    sheet(tmp_path / "pg.xlsx", [header, ("a", "35", 20.5, 20, 6.25, "2"), ("b", 10, None, 10, 1, 1)])
    assert {name: boxes_of(order) for name, order in read(tmp_path / "pg.xlsx", "1 row that lacks").items()} == {
        "a": [(350, 205, 200, 6.25)] * 2
    }


def test_two_readings_are_refused_and_options_decide(tmp_path: Path) -> None:
    (tmp_path / "units.csv").write_text("sku,length,width,height,qty\na,30,20,15,4\n")
    (tmp_path / "weights.csv").write_text("sku,L,B,H,Gewicht,Menge\na,400,300,200,48,24\n")
    (tmp_path / "layers.csv").write_text("sku,L,B,H,weight,qty,layers\na,400,300,200,6.5,8,2\n")
    for name, message in (
        ("units.csv", r"lengths in centimetres \(boxes of 300 × 200 × 150 mm\), or lengths in inches .*--units"),
        ("weights.csv", "Gewicht is of one box, or of all boxes of a row; .*--columns 'total weight=Gewicht'"),
        ("layers.csv", "qty counts the boxes of one layer, or of all layers; .*--columns 'per layer=qty'"),
    ):
        with pytest.raises(InputError, match=f"{name}: can be read in two ways: {message}"):
            list(read_orders(tmp_path / name))
    (order,) = read(tmp_path / "units.csv", units="in").values()
    assert boxes_of(order)[0][:3] == pytest.approx((762, 508, 381))
    for columns, kg in (({"weight": "Gewicht"}, 48), ({"total weight": "-"}, 48), ({"total weight": "Gewicht"}, 2)):
        (order,) = read(tmp_path / "weights.csv", columns=columns).values()
        assert (len(order.items), order.items[0].weight_kg) == (24, kg)
    (tmp_path / "unit.csv").write_text("sku,L,B,H,unit weight,density\na,400,300,200,6,200\n")
    for columns, kg in (({}, 6), ({"weight": "-"}, 4.8)):
        (order,) = read(tmp_path / "unit.csv", columns=columns).values()
        assert order.items[0].weight_kg == pytest.approx(kg)
    for role, count in (("quantity", 8), ("per layer", 16)):
        (order,) = read(tmp_path / "layers.csv", columns={role: "qty"}).values()
        assert len(order.items) == count


@pytest.mark.parametrize(("unit", "other_mm"), [("cm", 600), ("mm", 60)])
def test_an_option_is_the_unit_of_cells_without_units_alone(unit: str, other_mm: float, tmp_path: Path) -> None:
    (tmp_path / "mixed.csv").write_text("sku,length,width,height,qty\na,400 mm,300 mm,200 mm,3\nb,60,40,30,2\n")
    (order,) = read(tmp_path / "mixed.csv", units=unit).values()
    assert [item.length_mm for item in order.items] == pytest.approx([400] * 3 + [other_mm] * 2)


def test_no_places_in_a_column_of_places(tmp_path: Path) -> None:
    for cells in (",,", "0,0,0"):
        (tmp_path / "a.csv").write_text(
            f"name,length,width,height,weight,x,y,z\ns,400,300,200,6.5,{cells}\nl,600,400,250,12,{cells}\n"
        )
        (order,) = read(tmp_path / "a.csv", "read as a table").values()
        assert near(order, [SMALL, LARGE])


def test_arrays_of_sizes(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", [[[4, 3, 2], [6, 4, 2]], [[5, 5, 5], [0, 0, 0]]])
    orders = read(tmp_path / "a.npy", "an array of sizes; 2 orders, 3 boxes; dm")
    assert [[box[:3] for box in boxes_of(order)] for order in orders.values()] == [
        [(400, 300, 200), (600, 400, 200)],
        [(500, 500, 500)],
    ]


def test_plans_are_read_as_the_orders_of_their_boxes(tmp_path: Path) -> None:
    (tmp_path / "plan.csv").write_text(
        "name,x,y,z,length,width,height,weight\ns,0,0,0,400,300,200,6.5\nl,0,0,200,400,300,200,6.5\n"
    )
    (order,) = read(tmp_path / "plan.csv", "holds plans: the boxes of each are an order, their places are not").values()
    assert near(order, [SMALL, SMALL])
    (tmp_path / "types.csv").write_text("name,length,width,height,weight,qty\ns,400,300,200,6.5,2\n")
    (skipped,) = petmjx.load_plans(tmp_path / "types.csv").skipped
    assert "no places; pack them first: petmjx samples --orders" in skipped.message


def test_plans_in_the_form_of_petmjx_are_read_as_orders_too(tmp_path: Path) -> None:
    note = "holds plans: the boxes of each are an order, their places are not used; read as petmjx's plans"
    corners = [[0, 0, 0], [0, 0, 200]]
    plans = [
        petmjx.Plan.from_boxes(name, size_mm=[SMALL[:3]] * n, corner_mm=corners[:n], mass_kg=[SMALL[3]] * n)
        for name, n in (("one", 1), ("two", 2))
    ]
    for name in ("plans.json", "plans.json.gz", "plans.csv"):
        petmjx.save_plans(plans, tmp_path / name)
        orders = read(tmp_path / name, note)
        assert near(orders["one"], [SMALL])
        assert near(orders["two"], [SMALL, SMALL])


def test_a_plan_among_orders_is_no_order(tmp_path: Path) -> None:
    item = {"article": "a", "id": "1", "length/mm": 400, "width/mm": 300, "height/mm": 200, "weight/kg": 6.5}
    order = {"item_sequence": {"1": item}, "properties": {"target": "euro-pallet"}}
    plan = [{"item": {**item, "sequence": 1}, "orientation": 0, "flb_coordinates": [0, 0, 0]}]
    (tmp_path / "orders.json").write_text(json.dumps({"o": order, "p": plan}))
    errors: list[InputError] = []
    assert [*dict(read_orders(tmp_path / "orders.json", errors.append))] == ["o"]
    assert "order p: is a packing plan, not an order" in str(errors[0])


DAMAGED: dict[str, tuple[str, str]] = {
    "length": ("a,4oo,300,200,5,1", 'row 3: length must be a number, got "4oo"'),
    "no width": ("a,400,,200,5,1", "row 3: width is missing"),
    "flat": ("a,400,300,0,5,1", "row 3: height must be > 0, got 0"),
    "huge": ("a,400,3000000,200,5,1", "row 3: width must be from"),
    "weightless": ("a,400,300,200,-5,1", "row 3: weight must be > 0"),
    "half a box": ("a,400,300,200,5,1.5", 'row 3: qty must be a whole number from 0 to 100,000, got "1.5"'),
    "minus a box": ("a,400,300,200,5,-1", "row 3: qty must be a whole number"),
    "many": ("a,400,300,200,5,600", ": must have at most 512 items, got 603"),
    "cells": ("a,400,300,200,5", "row 3: has 5 fields instead of 6"),
}


@pytest.mark.parametrize("name", DAMAGED)
def test_a_damaged_value_is_one_line(name: str, tmp_path: Path) -> None:
    row, message = DAMAGED[name]
    path = tmp_path / "items.csv"
    path.write_text(f"sku,length,width,height,weight,qty\nb,400,300,200,5,1\n{row}\nc,500,300,200,5,2\n")
    bad: list[InputError] = []
    with pytest.warns(PlanWarning):
        assert not list(read_orders(path, bad.append))
    (line,) = map(str, bad)
    assert line.startswith(f"{path}: order items")
    assert message in line
    assert line.isprintable()


@pytest.mark.parametrize(
    ("row", "message"),
    [("400,-5,200,5,2", "width must be > 0, got -5"), ("400,300,200,1e99,2", "weight must be from")],
)
def test_the_only_row_is_named_when_it_is_damaged(row: str, message: str, tmp_path: Path) -> None:
    """If the only row is damaged, the message names this row. Units cannot be derived from its values."""
    (tmp_path / "a.csv").write_text(f"sku,length,width,height,weight,qty\ns,{row}\n")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PlanWarning)
        with pytest.raises(InputError, match=f"a.csv: .*row 2: {message}"):
            list(read_orders(tmp_path / "a.csv"))


PROBLEMS: dict[str, tuple[str, str, str]] = {
    "size": (" 1 108 0", " 1 1o8 0", 'order thpack1-1, line 5: length must be a number, got "1o8"'),
    "mark": (" 1 108 0", " 1 108 2", "line 5: after a size, 1 or 0 must say whether it may be vertical, got 2"),
    "types": (" 587 233 220\n 1\n", " 587 233 220\n 2\n", "line 9: announces 2 box types, but only 1 before the end"),
    "more types": (
        " 587 233 220\n 2\n",
        " 587 233 220\n 1\n",
        "line 6: is one box type more than the 1 that line 4 announces",
    ),
    "container": (
        "1 2502505\n 587 233 220",
        "1 2502505\n 587 x 220",
        "line 3: must be length, width and height of the",
    ),
    "truncated": (" 2\n 1 25", " 3\n 1 25", "line 1: announces 3 problems, but the file contains 2"),
    "no quantity": ("45 1 3\n", "45 1 3.5\n", "line 10: quantity must be a whole number"),
}


@pytest.mark.parametrize("name", PROBLEMS)
def test_a_damaged_problem_is_one_line(name: str, tmp_path: Path) -> None:
    before, after, message = PROBLEMS[name]
    assert before in THPACK
    path = tmp_path / "thpack1.txt"
    path.write_text(THPACK.replace(before, after, 1))
    lines: list[str] = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PlanWarning)  # warnings about problems without faults
        try:
            list(read_orders(path, lambda error: lines.append(str(error))))
        except InputError as error:
            lines.append(str(error))
    assert len(lines) == 1
    assert message in lines[0]


def test_orders_go_the_way_of_bed_bpps(tmp_path: Path) -> None:
    """Orders of other tools can be packed by a packer, and used by an environment, like orders of BED-BPP."""
    path = tmp_path / "items.csv"
    path.write_text("Pallet,name,length,width,height,qty\n" + "a,s,40,30,20,4\nb,s,40,30,20,2\n")
    reading, left = reading_of(True, "1200x1000", {"units": "cm", "density": 200, "worlds": 0})
    assert left == {"worlds": 0}
    with pytest.warns(PlanWarning, match="packed on 1200x1000; no weights: 200 kg/m³"):
        placed = dict(pack_orders(path, reading=reading))
    assert {name: len(placements) for name, placements in placed.items()} == {"a": 4, "b": 2}
    assert placed["a"][0]["item"]["weight/kg"] == pytest.approx(0.4 * 0.3 * 0.2 * 200)
    with pytest.warns(PlanWarning):
        assert len(list(orders_of(path, None, 0, None, reading))) == 2
    with pytest.raises(InputError, match="density applies only to a file of orders, but these orders are generated"):
        reading_of(False, None, {"density": 200})
    with pytest.warns(PlanWarning):
        boxes = Orders(path, reading=reading).some(0)
    assert [len(order) for order in boxes] == [4, 2]
    frame = pd.DataFrame({"Länge (cm)": [40], "Breite (cm)": [30], "Höhe (cm)": [20], "Menge": [3]})
    with pytest.warns(PlanWarning):
        (order,) = Orders(frame).some(0)
    assert order.size_mm.tolist() == [[400, 300, 200]] * 3
    with pytest.warns(PlanWarning, match="^orders: read as a data frame; 1 order, 3 boxes"):
        ((name, ordered),) = orders_of(frame, None, 0)
    assert (name, len(ordered.items)) == ("orders", 3)


def test_orders_are_written_as_bed_bpps(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Orders that are written in BED-BPP's format are read again, equal to the last bit, by commands that have no
    options for other formats."""
    monkeypatch.chdir(tmp_path)
    Path("items.csv").write_text("sku,length,width,height,qty\na,30,20,15.1,4\nb,20,20,20,1\n")
    hint = "items.csv: can be read in two ways: .*; the command 'petmjx convert items.csv --orders -o orders.json'"
    with pytest.raises(InputError, match=hint):
        list(read_orders(Path("items.csv")))
    convert = ["convert", "items.csv", "--orders", "-o", "orders.json", "--units", "cm", "--target", "1200x1000"]
    assert run(*convert) == 0
    out, err = capsys.readouterr()
    assert out == "1 order (5 boxes) in orders.json\n"
    assert err.startswith("note: items.csv: read as a table as text; 1 order, 5 boxes; cm; columns length, width,")
    assert dict(read_orders(Path("orders.json"))) == read(Path("items.csv"), units="cm", target="1200x1000")
    record = json.loads(Path("orders.json").read_text())["items"]
    assert record["properties"] == {"target": "1200x1000"}
    assert record["item_sequence"]["5"] == {
        "article": "b", "id": "b", "product_group": "", "length/mm": 200, "width/mm": 200, "height/mm": 200,
        "weight/kg": 0.008 * USUAL_KG_M3, "sequence": 5,
    }  # fmt: skip


def test_info_says_how_orders_are_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("thpack1.txt").write_text(THPACK)
    assert run("info", "thpack1.txt") == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "thpack1.txt: orders, which have no places"
    assert lines[1].split(maxsplit=1)[1].startswith("a container loading problem (thpack); 2 orders, 6 boxes; cm")
    assert lines[2].endswith("petmjx samples --orders thpack1.txt -o plans.json")
    Path("units.csv").write_text("sku,length,width,height,qty\na,30,20,15,4\n")
    assert run("info", "units.csv") == 0
    assert "can be read in two ways: lengths in centimetres" in capsys.readouterr().out
    assert run("info", "units.csv", "--units", "in") == 0
    assert "a table as text; 1 order, 4 boxes; in" in capsys.readouterr().out


def test_a_board_keeps_orders_in_bed_bpps_form(tmp_path: Path) -> None:
    (tmp_path / "items.csv").write_text("Pallet,length,width,height,weight\na,400,300,200,6.5\nb,600,400,250,12\n")
    with pytest.warns(PlanWarning):
        keep_orders(tmp_path / "items.csv", tmp_path / "orders.json")
    assert {name: boxes_of(order) for name, order in read_orders(tmp_path / "orders.json")} == {
        "a": [SMALL],
        "b": [LARGE],
    }
    keep_orders(tmp_path / "orders.json", tmp_path / "copy.json")
    assert (tmp_path / "copy.json").read_bytes() == (tmp_path / "orders.json").read_bytes()


def test_targets() -> None:
    assert target_named("1200 × 1000") == "1200x1000"
    assert target_extent_mm("rollcontainer") == (800, 700)
    assert target_extent_mm("1219.2x1016") == (1219.2, 1016)
    for text in ("epal", "1200", "1x1", "1200x", "-5x900"):
        with pytest.raises(InputError, match="target must be euro-pallet, rollcontainer or its sizes in mm"):
            target_named(text)


CASES: dict[str, Callable[[dict[str, Order]], bool]] = {
    "types_and_quantities.csv": lambda orders: [len(order.items) for order in orders.values()] == [24],
    "packingsolver_items.csv": lambda orders: [len(order.items) for order in orders.values()] == [22],
    "py3dbp.csv": lambda orders: len(orders) == 1,
    "german_headers.csv": lambda orders: len(orders) >= 1,
}


@pytest.mark.parametrize("name", CASES)
def test_shared_files(name: str) -> None:
    path = Path(__file__).parents[3] / "shared" / "cases" / "files" / name
    if not path.is_file():
        pytest.skip(f"{os.fspath(path)} is absent")
    assert CASES[name](read(path, "read as|holds plans"))


BOXES = {"length_mm": [600, 600], "width_mm": 400, "height_mm": 200, "weight_kg": [8, 9]}


@pytest.mark.parametrize(
    ("name", "cells", "counts"),
    [("order", ["a", "b"], [1, 1]), ("plan_id", ["a", "b"], [1, 1]), ("quantity", [3, 4], [7])],
)
def test_columns_beside_petmjxs_own_names_count_for_episodes(
    name: str, cells: list[Any], counts: list[int], tmp_path: Path
) -> None:
    """In tables for episodes, the column with the order may have any name, and quantities are used, as for
    ``samples --orders``."""
    frame = pd.DataFrame({**BOXES, name: cells})
    frame.to_csv(tmp_path / "own.csv", index=False)
    frame.to_parquet(tmp_path / "own.parquet", index=False)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PlanWarning)
        for source in (frame, tmp_path / "own.csv", tmp_path / "own.parquet"):
            assert [len(boxes) for boxes in Orders(source).some(0)] == counts
        (tmp_path / "own.csv").write_text(
            f"length_mm,width_mm,height_mm,weight_kg,{name},gross weight kg\n6,4,2,8,1,1.5\n"
        )
        (boxes,) = Orders(tmp_path / "own.csv", reading=order_reading("cm", {"weight": "gross weight kg"})).some(0)
    assert boxes.size_mm.tolist() == [[60, 40, 20]]
    assert boxes.mass_kg.tolist() == [1.5]


def test_tables_of_petmjxs_own_names_are_read_in_silence_with_strengths_and_sides(tmp_path: Path) -> None:
    frame = pd.DataFrame({**BOXES, "order_id": 7, "strength_n": [None, 90.5], "upright": [None, "Lh"]}, index=[0, 0])
    frame.to_csv(tmp_path / "own.csv", index=False)
    for source in (frame, frame.convert_dtypes(), tmp_path / "own.csv"):
        (boxes,) = Orders(source).some(0)
        np.testing.assert_array_equal(boxes.strength_n, [np.nan, 90.5])
        assert boxes.upright is not None
        assert boxes.upright.tolist() == [[False, False, True], [True, False, True]]
    with pytest.warns(PlanWarning, match="order_id filled down"):
        assert len(Orders(frame.assign(order_id=["a", None])).some(0)) == 1
    (boxes,) = Orders(pd.DataFrame(dict(zip(BOXES, np.outer([1, 1, 1, 1], [600, 200, 400]), strict=True)))).some(0)
    assert len(boxes) == 3, "the last box is no row of means"
    frame.assign(x_mm=[0, 600], y_mm=0, z_mm=[0, 1]).to_csv(tmp_path / "placed.csv", index=False)
    with pytest.warns(PlanWarning, match="not used: x_mm, y_mm, z_mm"):
        assert Orders(tmp_path / "placed.csv").lie
    frame.drop(columns="upright").assign(x_mm=[0, 600], y_mm=5, z_mm=9, plan_id="p").to_csv(tmp_path / "plan.csv")
    with pytest.warns(PlanWarning):
        assert Orders(tmp_path / "plan.csv").have_strengths
    with pytest.warns(PlanWarning, match="not used: strength_n, upright"):
        assert len(list(orders_of(frame, None, 0))) == 1


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("600,400,200,8,5", "row 2: has 5 fields instead of 4"),
        ("True,400,200,8", 'row 2: length_mm must be a number, got "True"'),
        ("600,400,200,-8", "row 2: weight_kg must be > 0, got -8"),
    ],
)
def test_bad_rows_of_orders_for_episodes_are_named(text: str, message: str, tmp_path: Path) -> None:
    (tmp_path / "own.csv").write_text(f"length_mm,width_mm,height_mm,weight_kg\n{text}\n{text}\n")
    with pytest.raises(InputError, match=rf"own\.csv: (order own, )?{message}"):
        Orders(tmp_path / "own.csv")
    twice = pd.DataFrame([[600, 400, 200, 8, 9]], columns=[*BOXES, "weight_kg"])
    for frame, fault in (
        (twice, "column weight_kg occurs twice"),
        (pd.DataFrame({**BOXES, "length_mm": [600 + 1j, 5]}), "row 0: length_mm must be a number, got complex"),
        (pd.DataFrame({**BOXES, "weight_kg": [True, False]}), "row 0: weight_kg must be a number, got true"),
        (pd.DataFrame({**BOXES, "strength_n": ["x", 5]}), 'order orders, row 0: strength_n must be a number, got "x"'),
    ):
        with pytest.raises(InputError, match=f"^orders: {fault}"):
            Orders(frame)


def test_an_article_with_the_means_of_the_others_is_no_mean(tmp_path: Path) -> None:
    """In metres with one decimal, a medium-sized article has the rounded means of two others."""
    rows = "sku;length [m];width [m];height [m];weight [kg]\na;0.6;0.4;0.2;9\nb;0.4;0.3;0.3;7\n"
    for last, count in (("c", 3), ("", 2), ("Ø", 2)):
        (tmp_path / "order.csv").write_text(f"{rows}{last};0.5;0.4;0.2;8\n")
        (order,) = read(tmp_path / "order.csv").values()
        assert len(order.items) == count
