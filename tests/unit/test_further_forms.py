"""Forms and conventions of further tools: one pile of boxes, written in each of them, is read the same, or a note says
what is not read."""

from __future__ import annotations

import io
import json
import math
import re
import time
from collections.abc import Callable, Sequence
from datetime import datetime
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import openpyxl
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import petmjx
from petmjx.common.units import FloatArray
from petmjx.plans.cell_numbers import cell_number
from petmjx.plans.column_names import split_unit
from petmjx.plans.input_conventions import ANCHORS
from petmjx.plans.order_reader import read_orders
from petmjx.plans.printed_values import printed_values
from petmjx.plans.readings import reading_toml

pytestmark = pytest.mark.filterwarnings("ignore::petmjx.PlanWarning")

PILE = ((0, 0, 0, 600, 400, 300, 12), (600, 0, 0, 600, 400, 300, 12), (0, 400, 0, 600, 400, 300, 12),
        (600, 400, 0, 600, 400, 300, 12), (0, 0, 300, 400, 300, 250, 6.5), (400, 0, 300, 400, 300, 250, 6.5),
        (0, 300, 300, 300, 400, 200, 5.25), (300, 300, 300, 500, 350, 180, 7.75))  # fmt: skip
"""(x, y, z, length, width, height, kg) of boxes on a pallet, mm."""
FIELDS = ("x", "y", "z", "length", "width", "height", "weight")
NAMES = "abcdefgh"
TURNED = (0, 1, 0, 1, 0, 1, 1, 0)
"""Boxes that some tools turn: their sizes before the turn have length and width exchanged."""


def load(tmp_path: Path, name: str, content: str | bytes, **options: Any) -> petmjx.PlanSet:
    file = tmp_path / name
    file.write_bytes(content.encode() if isinstance(content, str) else content)
    return petmjx.load_plans(file, **options)


def notes_of(plan_set: petmjx.PlanSet) -> str:
    (reading,) = plan_set.readings.values()
    return reading.line()


def check_pile(plan: petmjx.Plan, weights: bool = True) -> None:
    wanted = np.array(PILE, float)
    np.testing.assert_allclose(plan.corner_mm, wanted[:, :3], atol=0.05)
    np.testing.assert_allclose(plan.size_mm, wanted[:, 3:6], atol=0.05)
    if weights:
        np.testing.assert_allclose(plan.mass_kg, wanted[:, 6], rtol=1e-4)


# Tables.

Row = Callable[[int, list[float]], Sequence[Any]]


def table(header: str, row: Row = lambda number, box: box, mark: str = ",", above: str = "") -> str:
    """A table as text. ``row`` gives the cells of a box from its number and its seven values."""
    lines = [mark.join(map(str, row(number, list(map(float, box))))) for number, box in enumerate(PILE)]
    return above + "\n".join([mark.join(header.split(",")), *lines, ""])


def named(number: int, box: list[float]) -> list[Any]:
    return [NAMES[number], *box]


def before_turn(number: int, box: list[float]) -> list[float]:
    length, width, height = box[3:6]
    return [width, length, height] if TURNED[number] else [length, width, height]


def centre(box: list[float]) -> list[float]:
    return [box[axis] + box[axis + 3] / 2 for axis in range(3)]


def framed(lines: str, bar: str, cross: str, line: str) -> str:
    """A printed table with frames. ``lines``: "all" rows have a line below them, or only the "header"."""
    rows = [["box", *FIELDS], *([NAMES[number], *map(str, box)] for number, box in enumerate(PILE))]
    between = cross + cross.join(line * 10 for _ in rows[0]) + cross
    shown = [bar + bar.join(cell.rjust(9) + " " for cell in row) + bar for row in rows]
    inner = f"\n{between}\n" if lines == "all" else "\n"
    return "\n".join([between, shown[0], between, inner.join(shown[1:]), between, ""])


def printed_frame(index: bool) -> str:
    """pandas' ``print(frame)``, whose index has no name; or a table with lines of "=" as in reStructuredText."""
    rows = [["box", *FIELDS], *([NAMES[number], *map(str, box)] for number, box in enumerate(PILE))]
    shown = ["  ".join(cell.rjust(7) for cell in row) for row in rows]
    if index:
        return "\n".join([f"   {shown[0]}", *(f"{number:<3}{line}" for number, line in enumerate(shown[1:])), ""])
    line = "  ".join("=" * 7 for _ in rows[0])
    return "\n".join([line, shown[0], line, *shown[1:], line, ""])


def report(title: str) -> str:
    """A report of two pages, with units below some names. ``title``: the title on the second page."""
    boxes = [[NAMES[number], *map(str, box[:6]), str(1000 * box[6])] for number, box in enumerate(PILE)]
    rows = [["box", *FIELDS], ["", *["[mm]"] * 6, "[g]"], *boxes]
    lines = ["  ".join(cell.rjust(7) for cell in row) for row in rows]
    pages = ["LOADS", "", "Pallet A", *lines[:7], "\fLOADS", title, *lines[:2], *lines[7:], ""]
    return "\n".join(pages)


def transposed() -> str:
    rows = [["Box", *NAMES], *([name, *values] for name, values in zip(FIELDS, zip(*PILE, strict=True), strict=True))]
    return "\n".join(";".join(map(str, row)) for row in rows)


def mixed_units(number: int, box: list[float]) -> list[Any]:
    factor = 10 if number % 2 else 1
    return [*(value / factor for value in box[:6]), box[6], "cm" if number % 2 else "mm"]


def far_corners(number: int, box: list[float]) -> list[Any]:
    return [box[axis] + box[axis + 3] for axis in range(3)] + box[3:]


def in_feet(number: int, box: list[float]) -> list[Any]:
    lengths = [f"{value / 304.8 // 1:.0f}'-{value / 25.4 % 12:.4f}\"" for value in box[:6]]
    return [NAMES[number], *lengths, box[6] / 0.45359237]


def in_pages() -> str:
    """A printed report of two pages, each with its head."""
    head = "LOAD REPORT      Page {} of 2\nCustomer: A\n\n" + "  ".join(name.rjust(7) for name in ("box", *FIELDS))
    head += "\n" + "  ".join(unit.rjust(7) for unit in ("#", *["(mm)"] * 6, "(kg)"))
    head += "\n" + "  ".join("-" * 7 for _ in range(8)) + "\n"
    lines = ["  ".join(str(cell).rjust(7) for cell in named(k, list(box))) + "\n" for k, box in enumerate(PILE)]
    return head.format(1) + "".join(lines[:5]) + "\n\f" + head.format(2) + "".join(lines[5:]) + "\nTotal boxes: 8\n"


def two_corners_in_turns(number: int, box: list[float]) -> list[Any]:
    return [value for axis in range(3) for value in (box[axis], box[axis] + box[axis + 3])] + [box[6]]


SIZES = "length,width,height"


def two_corners(box: Sequence[float]) -> list[float]:
    """The near corner and the far corner of a box."""
    return [*box[:3], *(start + side for start, side in zip(box[:3], box[3:6], strict=True))]


def eight_corners(box: Sequence[float]) -> list[float]:
    ends = two_corners(box)
    return [ends[axis + 3 * (number >> axis & 1)] for number in range(8) for axis in range(3)]


TABLES = {
    "words for boxes": table("LPN,Loc X,Loc Y,Loc Z,Ctn L,Ctn W,Ctn H,Gross Wt (kg)", named),
    "short words": table("carton_id,x,y,z,len_mm,wid_mm,hgt_mm,wg", named),
    "German compounds": table(
        "Kartonnr,X,Y,Z,Artikellänge (mm),Kartonbreite (mm),Packstückhöhe (mm),Stückgewicht (kg)", named, mark=";"
    ),
    "Portuguese": table("Caixa,X,Y,Z,Comprimento,Largura,Altura,Peso", named, mark=";"),
    "Dutch": table("Doos,X,Y,Z,Lengte,Breedte,Hoogte,Gewicht", named, mark=";"),
    **{
        language: table(f"Kod,X,Y,Z,{names}", named, mark=";")
        for language, names in {
            "Czech": "Délka,Šířka,Výška,Hmotnost",
            "Danish": "Længde,Bredde,Højde,Vægt",
            "Norwegian": "Lengde,Bredde,Høyde,Vekt",
            "Swedish": "Längd,Bredd,Höjd,Vikt",
            "Finnish": "Pituus,Leveys,Korkeus,Paino",
            "Hungarian": "Hosszúság,Szélesség,Magasság,Súly",
            "Romanian": "Lungime,Lățime,Înălțime,Greutate",
        }.items()
    },
    "numbers of rows in a column Br": table(
        "Br,Box,X,Y,Z,Duljina,Širina,Visina,Težina", lambda k, box: [k + 1, *named(k, box)], mark=";"
    ),
    "names of SAP": table("MATNR,XPOS,YPOS,ZPOS,LAENG,BREIT,HOEHE,BRGEW", named, mark=";"),
    "planes of boxes": table(
        "Index;Plane Origin;X Axis;Y Axis;Box Size;Mass".replace(";", ","),
        lambda k, box: [
            NAMES[k],
            '"{{{}, {}, {}}}"'.format(*centre(box)[:2], box[2]),
            '"{0, 1, 0}"' if TURNED[k] else '"{1, 0, 0}"',
            '"{-1, 0, 0}"' if TURNED[k] else '"{0, 1, 0}"',
            '"{{{}, {}, {}}}"'.format(*before_turn(k, box)),
            box[6],
        ],
    ),
    "short French words": table("Colis,X,Y,Z,Lg (mm),lg (mm),Ht (mm),Poids", named, mark=";"),
    "words for coordinates": table(f"box,xcoor,ycoor,zcoor,{SIZES},kg", named),
    "feet and inches": table(f"box,x,y,z,{SIZES},weight (lb)", in_feet),
    "two lines of a header": table(
        ",L,W,H,(kg),X,Y,Z,",
        lambda k, box: [NAMES[k], *box[3:6], box[6], *box[:3], "no"],
        above="Box,Dimensions (mm),,,Weight,Position (mm),,,Tilted\n",
    ),
    "pages of a report": in_pages(),
    "units in camel case": table("boxId,posXmm,posYmm,posZmm,sizeXmm,sizeYmm,sizeZmm,massGrams",
                                 lambda k, box: [NAMES[k], *box[:6], 1000 * box[6]]),
    "comments above": table(f"box,x,y,z,{SIZES},weight", named, above="# by Packer 3\n# pallet: 1200 x 800\n"),
    "headings with units": table("Box,L,B,H,X,Y,Z,[kg]", lambda k, box: [NAMES[k], *box[3:6], *box[:3], box[6]],
                                 above=",Abmessungen (mm),,,Position (mm),,,Gewicht\n"),
    "spaces in the header alone": table("Box #,X (mm),Y (mm),Z (mm),Case Length (mm),Case Width (mm),Case Height (mm),"
                                        "Case Weight (kg)", named),
    "frames of lines": framed("all", "│", "┼", "─"),
    "frames of dashes": framed("header", "|", "+", "-"),
    "lines of equals signs": printed_frame(index=False),
    "a printed data frame": printed_frame(index=True),
    "names in the first column": transposed(),
    "letters of rotations": table(
        "id,l,w,h,kg,x,y,z,how",
        lambda k, box: [NAMES[k], *before_turn(k, box), box[6], *box[:3], "WLH" if TURNED[k] else "LWH"],
        mark="|",
    ),
    "words of rotations": table(
        f"name,x,y,z,{SIZES},mass,orientation",
        lambda k, box: [NAMES[k], *box[:3], *before_turn(k, box), box[6], "across" if TURNED[k] else "along"],
    ),
    "radians": table(
        f"name,x,y,z,{SIZES},mass,yaw_rad",
        lambda k, box: [NAMES[k], *box[:3], *before_turn(k, box), box[6], 1.5708 if TURNED[k] else 0.0],
    ),
    "angles about three axes": table(
        f"name,x,y,z,rx,ry,rz,{SIZES},mass",
        lambda k, box: [NAMES[k], *centre(box), 0, 0, 90 * TURNED[k], *before_turn(k, box), box[6]],
    ),
    "roll, pitch and yaw": table(
        f"name,x,y,z,roll,pitch,yaw,{SIZES},mass",
        lambda k, box: [NAMES[k], *centre(box), 0, 0, 1.5708 * TURNED[k], *before_turn(k, box), box[6]],
    ),
    "numbers of permutations": table(
        "id,l,w,h,kg,x,y,z,rotation",
        lambda k, box: [NAMES[k], box[5], *before_turn(k, box)[:2], box[6], *box[:3], 5 if TURNED[k] else 3],
    ),
    "tare and net": table(f"id,tare_kg,net_kg,x,y,z,{SIZES}", lambda k, box: [NAMES[k], 0.4, box[6], *box[:6]]),
    "units of angles below": table(
        f"name,x,y,z,{SIZES},mass,rotation",
        lambda k, box: [NAMES[k], *box[:3], *before_turn(k, box), box[6], 90 * TURNED[k]],
    ).replace("\n", "\n[-],[mm],[mm],[mm],[mm],[mm],[mm],[kg],[°]\n", 1),
    "a column of units": table("x,y,z,l,w,h,kg,uom", lambda k, box: [*(v / 10 for v in box[:6]), box[6], "cm"]),
    "rows in two units": table("x,y,z,l,w,h,kg,unit", mixed_units),
    "net and gross": table(f"carton,net_kg,gross_kg,{SIZES},x,y,z",
                           lambda k, box: [NAMES[k], 0.8 * box[6], box[6], *box[3:6], *box[:3]]),
    "weights by their unit": table(f"box,x,y,z,{SIZES},how heavy", lambda k, box: [NAMES[k], *box[:6], f"{box[6]} kg"]),
    "names of orders": table(f"order,box,x,y,z,{SIZES},weight", lambda k, box: ["ORD-7", *named(k, box)]),
    "the number of an order": table(f"order,box,x,y,z,{SIZES},weight", lambda k, box: [4711, *named(k, box)]),
    "unloading": table(f"unload_step,box,x,y,z,{SIZES},weight", lambda k, box: [8 - k, *named(k, box)]),
    "picks of a robot": table(f"box,pick_x,pick_y,pick_z,place_x,place_y,place_z,{SIZES},weight",
                              lambda k, box: [NAMES[k], -1500, 200, 900, *box]),
    "far corners with sizes": table(f"end_x,end_y,end_z,{SIZES},weight", far_corners),
    "tabs between cells with commas": table(
        "Item;Pos(x,y,z) [mm];Dim(l,w,h) [mm];Mass [kg]".replace(",", "\0"),
        lambda k, box: [NAMES[k], "({}, {}, {})".format(*box), "({3}, {4}, {5})".format(*box), box[6]],
        mark="\t",
    ).replace("\0", ",").replace(";", "\t"),
    "half sizes": table("Volume nº,cx,cy,cz,hx,hy,hz,mass",
                        lambda k, box: [NAMES[k], *centre(box), *(side / 2 for side in box[3:6]), box[6]]),
    "names of axes": table("Colis;Abscisse (mm);Ordonnée (mm);Cote (mm);Longueur;Largeur;Hauteur;Poids", named).replace(
        ",", ";"
    ),
    "middles of tops": table(
        "name,tcp_x,tcp_y,tcp_z,A,length,width,height,mass",
        lambda k, box: [NAMES[k], *centre(box)[:2], box[2] + box[5], 90 * TURNED[k], *before_turn(k, box), box[6]],
    ),
    "a column of thousands": table(
        f"box;x;y;z;{SIZES.replace(',', ';')};weight",
        lambda k, box: [NAMES[k], *(f"{value:.1f}".replace(".", ",") for value in box[:6]), f"{box[6]:.3f}"],
        mark=";",
    ).replace("weight", "weight [g]"),
    "distances from sides": table(f"piece,{SIZES},from left,from front,from floor,weight",
                                  lambda k, box: [NAMES[k], *box[3:6], *box[:3], box[6]]),
    "answers under an unknown name": table(
        f"name,x,y,z,{SIZES},mass,dönük,fragile",
        lambda k, box: [NAMES[k], *box[:3], *before_turn(k, box), box[6], "yes" if TURNED[k] else "no", k],
    ),
    "a report of two pages": report(""),
    "a report with repeated titles": report("Pallet A (continued)"),
    "two words under an unknown name": table(
        f"name,x,y,z,{SIZES},mass,facing",
        lambda k, box: [NAMES[k], *box[:3], *before_turn(k, box), box[6], "NE"[TURNED[k]]],
    ),
    "initials of yes and no": table(
        f"name,x,y,z,{SIZES},peso,girado",
        lambda k, box: [NAMES[k], *box[:3], *(before_turn(k, box) if k == 6 else box[3:6]), box[6], "NS"[k == 6]],
    ),
    "places in brackets": "\n".join(
        ["box   pos(x,y,z)      dim(l, w, h)     kg"]
        + [f"{NAMES[k]}   ({x},{y},{z})    ({x_size}, {y_size}, {z_size})    {kg}"
           for k, (x, y, z, x_size, y_size, z_size, kg) in enumerate(PILE)]
    ),
    "remarks around boxes": table(f"box,x,y,z,{SIZES},weight", named).replace("a,", "Boxes: 8,,,,,,,\na,", 1)
    + "Cube utilization: 81.2 %,,,,,,,\n",
    "a remark between boxes": table(f"box,x,y,z,{SIZES},weight", named).replace("f,", "checked by A,,,,,,,\nf,", 1),
    "sections of layers": table(f"box,x,y,z,{SIZES},weight", named, mark=";").replace("e;", "Layer 2;;;;;;;\ne;", 1)
    .replace("a;", "Layer 1;;;;;;;\na;", 1),
    "LaTeX": "\\begin{tabular}{lrrrrrrr}\n\\toprule\n"
    + table(f"box,$x$,$y$,$z$,{SIZES},\\textbf{{Weight}} (kg)", named, mark=" & ").replace("\n", " \\\\\n")
    + "\\end{tabular}\n",
    "MATLAB": "T =\n\n  8x8 table\n\n"
    + "\n".join("    ".join(cell.rjust(7) for cell in row) for row in (
        ["box", *FIELDS], ["_" * 7] * 8, [" "], *([NAMES[k], *map(str, box)] for k, box in enumerate(PILE)))) + "\n",
    "lengths along axes": table("box,pos_x,pos_y,pos_z,len_x,len_y,len_z,weight", named),
    "Markdown": "\n".join(
        [f"| box | {' | '.join(FIELDS)} |", "|:---|" + "---:|" * len(FIELDS)]
        + [f"| {NAMES[k]} | " + " | ".join(map(str, box)) + " |" for k, box in enumerate(PILE)]
    ),
    "centres of bases": table(f"box,center_x_mm,center_y_mm,bottom_z_mm,{SIZES.replace(',', '_mm,')}_mm,mass_kg",
                              lambda k, box: [NAMES[k], *centre(box)[:2], *box[2:]]),
    "sides": table("left,right,front,back,bottom,top,weight", two_corners_in_turns),
    "sides in dm": table("left (dm),right (dm),front (dm),back (dm),bottom (dm),top (dm),weight",
                         lambda k, box: [*(value / 100 for value in two_corners_in_turns(k, box)[:6]), box[6]]),
    "densities in their unit": table(
        f"box,x,y,z,{SIZES},density (kg/m3)",
        lambda k, box: [NAMES[k], *box[:6], 1e9 * box[6] / math.prod(box[3:6])],
    ),
    "a letter that is also a unit of mass": table("box,x,y,z,length,width,H_g,weight", named),
    "letters in cells": table(
        "box,position,size,kg",
        lambda k, box: [NAMES[k], "z={2} y={1} x={0}".format(*box), "B={4} L={3} H={5}".format(*box), box[6]],
    ),
    "coordinates with the names of axes": table(
        f"box,Pos,{SIZES},kg", lambda k, box: [NAMES[k], "x={} y={} z={}".format(*box), *box[3:]]
    ),
    "two corners in a cell": table("Box,Corners (min and max),kg", lambda k, box: [
        NAMES[k], "({},{},{}),({},{},{})".format(*two_corners(box)), box[6]], mark=";"),
    "extremities": table("Item;X origin;Y origin;Z origin;X extremity;Y extremity;Z extremity;kg",
                         lambda k, box: [NAMES[k], *two_corners(box), box[6]], mark=";"),
    "last cells": table("box,x_min,y_min,z_min,x_max,y_max,z_max,kg", lambda k, box: [
        NAMES[k], *(value // 10 for value in box[:3]), *(value // 10 - 1 for value in two_corners(box)[3:]), box[6]]),
    "eight corners": table("box," + ",".join(f"{axis}{number}" for number in range(1, 9) for axis in "xyz") + ",kg",
                           lambda k, box: [NAMES[k], *eight_corners(box), box[6]]),
    "letters of placed sizes": table(
        "id,L_cm,W_cm,H_cm,weight_kg,placed_x_cm,placed_y_cm,placed_z_cm,orient_L_cm,orient_W_cm,orient_H_cm",
        lambda k, box: [NAMES[k], *(box[axis] / 10 for axis in (4, 5, 3)), box[6], *(v / 10 for v in box[:6])]),
    "numbered sizes": table("id,size_1,size_2,size_3,sp_size_1,sp_size_2,sp_size_3,x,y,z,kg", lambda k, box: [
        NAMES[k], box[4], box[5], box[3], *box[3:6], *box[:3], box[6]]),
    "w for weights": table("id,x,y,z,l,d,h,w", named),
    "Turkish": table("Kutu,X,Y,Z,Boy (cm),En (cm),Yükseklik (cm),Ağırlık (kg)",
                     lambda k, box: [NAMES[k], *(value / 10 for value in box[:6]), box[6]], mark=";"),
    "corners in turns": table("X1,X2,Y1,Y2,Z1,Z2,weight", two_corners_in_turns),
    "a web page": "<html><body><table><tr>"
    + "".join(f"<th>{name}</th>" for name in ("box", *FIELDS))
    + "</tr>"
    + "".join(f"<tr>{''.join(f'<td>{cell}</td>' for cell in named(k, list(box)))}</tr>" for k, box in enumerate(PILE))
    + "</table></body></html>",
}  # fmt: skip


"""Tables of the pile."""
WITHOUT_IDS = (
    "a column of units",
    "rows in two units",
    "far corners with sizes",
    "sides",
    "sides in dm",
    "corners in turns",
)


@pytest.mark.parametrize("name", TABLES)
def test_tables_in_further_conventions(name: str, tmp_path: Path) -> None:
    plan_set = load(tmp_path, "pile.txt", TABLES[name])
    assert not plan_set.skipped
    (plan,) = plan_set.plans
    check_pile(plan)
    assert plan.item_ids == (("",) * 8 if name in WITHOUT_IDS else tuple(NAMES))


# Documents.


def boxes_by(fields: Callable[[list[float]], dict[str, Any]], ids: str = "id") -> list[dict[str, Any]]:
    """The boxes as objects, with the fields that a function gives for the seven values of a box."""
    return [{ids: name, **fields(list(map(float, box)))} for name, box in zip(NAMES, PILE, strict=True)]


def plain(box: list[float]) -> dict[str, Any]:
    return dict(zip(FIELDS, box, strict=True))


def with_points(box: list[float]) -> dict[str, Any]:
    """A placement with free points beside it, which look like boxes: a program that draws packings writes them."""
    points = [{"x": box[0] + box[3], "y": box[1], "z": box[2], "dx": 300.0, "dy": 200.0, "dz": 100.0}] * 3
    stackable = {"dx": box[3], "dy": box[4], "dz": box[5]}
    return {"x": box[0], "y": box[1], "z": box[2], "stackable": stackable, "weight": box[6], "points": points}


def with_pose(box: list[float]) -> dict[str, Any]:
    """A collision object of a robot: the pose of a centre, m."""
    pose = {
        "position": dict(zip("xyz", (value / 1e3 for value in centre(box)), strict=True)),
        "orientation": {"x": 0.0, "y": 0.0, "z": math.sqrt(0.5), "w": math.sqrt(0.5)},
    }
    dimensions = [box[4] / 1e3, box[3] / 1e3, box[5] / 1e3]
    return {"primitive": {"type": 1, "dimensions": dimensions}, "pose": pose, "mass": box[6]}


def turned(rotation: Any) -> list[dict[str, Any]]:
    """Boxes turned by 90° about z, with this rotation in any form."""
    return boxes_by(
        lambda box: {"position": centre(box), "rotation": rotation, "size": [box[4], box[3], box[5]], "kg": box[6]}
    )


def sized(box: list[float]) -> dict[str, Any]:
    return {"dims": box[3:6], "mass": box[6]}


def stacks() -> Any:
    """Boxes that have only a height, in stacks that have a place."""
    by_place: dict[tuple[Any, ...], list[Any]] = {}
    for box in boxes_by(plain):
        by_place.setdefault((box.pop("x"), box.pop("y")), []).append(box)
    return {"stacks": [{"x": x, "y": y, "boxes": boxes} for (x, y), boxes in by_place.items()]}


def corners(box: list[float]) -> list[list[float]]:
    ends = [(box[axis], box[axis] + box[axis + 3]) for axis in range(3)]
    return [[x, y, z] for x in ends[0] for y in ends[1] for z in ends[2]]


def layers(key: str = "layers") -> Any:
    """Boxes without a z, in layers that have it."""
    heights = sorted({box[2] for box in PILE})
    by_height = {z: [box for box in boxes_by(plain) if box["z"] == z] for z in heights}
    for boxes in by_height.values():
        for box in boxes:
            del box["z"]
    return {"pallet": {"length": 1200, "width": 800}, key: [{"z": z, "boxes": boxes} for z, boxes in by_height.items()]}


def printed(boxes: Sequence[dict[str, Any]]) -> str:
    """Dictionaries as Python prints them, one in each line."""
    shown = "\n".join(str({**box, "position": [box["x"], box["y"], 0.5]}) for box in boxes)
    return re.sub(r"'(x|y|z)': ([\d.]+)", r"'\1': Decimal('\2')", shown)


def in_units(box: list[float]) -> dict[str, Any]:
    size = dict(zip(FIELDS[3:6], (value / 25.4 for value in box[3:6]), strict=True))
    place = dict(zip("xyz", (value / 25.4 for value in box[:3]), strict=True))
    return {
        "dimensions": {**size, "unit": "in"},
        "position": place,
        "weight": {"amount": box[6] / 0.45359237, "unit": "lb"},
    }


def nested(tag: str, value: Any) -> str:
    """XML with one element for each box."""
    boxes = "".join(
        f'<Box id="{box["id"]}"><Pos x="{box["x"]}" y="{box["y"]}" z="{box["z"]}"/><Size unit="mm">'
        f"<Length>{box['length']}</Length><Width>{box['width']}</Width><Height>{box['height']}</Height></Size>"
        f"<Weight>{box['weight']}</Weight></Box>"
        for box in value
    )
    return f'<?xml version="1.0" encoding="UTF-8"?><{tag} xmlns="urn:packer">{boxes}</{tag}>'


def upwards_y(box: list[float]) -> tuple[list[float], list[float]]:
    """The centre and the sizes of a box before its turn, in metres, with y upwards."""
    x, y, z = (value / 1e3 for value in centre(box))
    return [x, z, y], [box[4] / 1e3, box[5] / 1e3, box[3] / 1e3]


def matrix_of_turn(at: Sequence[float], scale: Sequence[float] = (1, 1, 1)) -> list[float]:
    """A matrix, column by column, that turns a box by 90° about the second axis, after scaling it."""
    return [0, 0, -scale[0], 0, 0, scale[1], 0, 0, scale[2], 0, 0, 0, *at, 1]


def in_lists(box: list[float]) -> dict[str, Any]:
    """A collision object whose only shape and its pose are in lists."""
    pose = with_pose(box)
    return {"primitives": [pose["primitive"]], "primitive_poses": [pose["pose"]], "mass": pose["mass"]}


def three_js(instances: bool = False) -> Any:
    """A scene of three.js whose boxes are in a group, with lights and a floor."""
    places = [upwards_y(list(map(float, box))) for box in PILE]
    shift = [-0.6, 0.2, -0.4]
    matrices = [matrix_of_turn([a - b for a, b in zip(at, shift, strict=True)]) for at, _ in places]
    meshes = [
        {"type": "Mesh", "name": name, "matrix": matrix, "geometry": f"of {name}", "userData": {"weight": box[6]}}
        for name, matrix, box in zip(NAMES, matrices, PILE, strict=True)
    ]
    geometries = [
        {"uuid": f"of {name}", "type": "BoxGeometry", "width": size[0], "height": size[1], "depth": size[2]}
        for name, (_, size) in zip(NAMES, places, strict=True)
    ]
    if instances:
        scaled = [matrix_of_turn([a - b for a, b in zip(at, shift, strict=True)], size) for at, size in places]
        meshes = [
            {
                "type": "InstancedMesh",
                "geometry": "cube",
                "count": 8,
                "instanceMatrix": {"array": [value for matrix in scaled for value in matrix]},
            }
        ]
        geometries = [{"uuid": "cube", "type": "BoxGeometry"}]
    group = {"type": "Group", "matrix": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, *shift, 1], "children": meshes}
    floor = {
        "type": "Mesh",
        "name": "ground",
        "geometry": "plane",
        "matrix": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1],
    }
    return {
        "metadata": {"version": 4.6, "type": "Object", "generator": "Object3D.toJSON"},
        "geometries": [*geometries, {"uuid": "plane", "type": "PlaneGeometry", "width": 9, "height": 9}],
        "object": {"type": "Scene", "children": [{"type": "AmbientLight"}, floor, group]},
    }  # fmt: skip


def gltf() -> Any:
    """A scene in glTF: one unit cube and one mesh with extents, in a node that moves them."""
    places = [upwards_y(list(map(float, box))) for box in PILE]
    nodes: list[Any] = []
    for name, (at, size), box in zip(NAMES, places, PILE, strict=True):
        quarter = [0, math.sqrt(0.5), 0, math.sqrt(0.5)]
        node = {"name": name, "translation": at, "rotation": quarter, "extras": {"weight_kg": box[6]}}
        # the second mesh is a cube of 2 m whose corner is the origin
        cube = {"mesh": 0, "scale": size}
        corner = [at[0] - size[2] / 2, at[1] - size[1] / 2, at[2] + size[0] / 2]
        far = {"mesh": 1, "scale": [side / 2 for side in size], "translation": corner}
        nodes.append(node | (far if len(nodes) % 2 else cube))
    meshes = [{"primitives": [{"attributes": {"POSITION": number}}]} for number in range(2)]
    accessors = [{"min": [-0.5] * 3, "max": [0.5] * 3}, {"min": [0, 0, 0], "max": [2, 2, 2]}]
    root = {"children": list(range(8)), "translation": [-0.6, 0.0, -0.4]}
    return {"asset": {"version": "2.0"}, "nodes": [*nodes, root], "meshes": meshes, "accessors": accessors}


def by_matrices(box: list[float]) -> dict[str, Any]:
    at, size = upwards_y(box)
    return {"matrix": matrix_of_turn(at), "geometry": dict(zip(("width", "height", "depth"), size, strict=True)),
            "weight": box[6]}  # fmt: skip


def scene() -> Any:
    """A scene as exported by three.js and Unity: scaled unit cubes, given by their centres in metres, with y upwards.
    The scene has no cube for the container."""
    cubes = {}
    for number, (x, y, z, length, width, height, kg) in enumerate(PILE):
        middle = {"x": (x + length / 2) / 1e3, "y": (z + height / 2) / 1e3, "z": (y + width / 2) / 1e3}
        scale = {"x": length / 1e3, "y": height / 1e3, "z": width / 1e3}
        cubes[f"cube {number}"] = {"position": middle, "localScale": scale, "mass": kg}
    return {"objects": cubes}


def by_columns(hole: str = "") -> Any:
    """JSON as written by ``to_json()`` of pandas: for each column, a value for each label of a row. The row ``hole``
    has no z."""
    columns = {name: {str(row): box[k] for row, box in enumerate(PILE)} for k, name in enumerate(FIELDS)}
    columns["z"].pop(hole, None)
    return columns


def with_units() -> Any:
    boxes = [dict(zip(FIELDS, [*(v / 25.4 for v in box[:6]), box[6] / 0.45359237], strict=True)) for box in PILE]
    return {"units": {"length": "in", "weight": "lb"}, "boxes": boxes}


def in_engine(box: list[float]) -> dict[str, Any]:
    """An object of a game engine: y upwards, turned about y, with a collider whose centre is relative to the object."""
    at, size = upwards_y(box)
    quarter = {"x": 0.0, "y": math.sqrt(0.5), "z": 0.0, "w": math.sqrt(0.5)}
    zero, one = dict.fromkeys("xyz", 0.0), dict.fromkeys("xyz", 1.0)
    transform = {"position": dict(zip("xyz", at, strict=True)), "rotation": quarter, "localScale": one}
    collider = {"center": zero, "size": dict(zip("xyz", size, strict=True))}
    return {"transform": transform, "boxCollider": collider, "rigidbody": {"mass": box[6]}}


def in_a_scene() -> list[dict[str, Any]]:
    """Boxes among the other objects of a scene."""
    boxes = boxes_by(
        lambda box: {"type": "MESH", "location": centre(box), "dimensions": box[3:6], "mass": box[6]}, "name"
    )
    lamp = {"name": "Lamp", "type": "LIGHT", "location": [4, 1, 6]}
    floor = {"name": "Floor", "type": "MESH", "location": [0, 0, 0], "dimensions": [9000, 9000, 0]}
    pallet = {"name": "A", "type": "MESH", "location": [600, 400, -72], "dimensions": [1200, 800, 144], "static": True}
    return [lamp, floor, pallet, *boxes]


PRINTED = {
    "Rust": (
        '    Placed {\n        id: "%(name)s",\n        at: Point {\n            x: %(x)s.0,\n            y: %(y)s.0,\n'
        "            z: %(z)s.0,\n        },\n        size: (%(length)s.0, %(width)s.0, %(height)s.0),\n"
        "        weight: Some(\n            %(weight)s,\n        ),\n    },\n"
    ),
    "Go": (
        "{Name:%(name)s Position:{X:%(x)s Y:%(y)s Z:%(z)s} Length:%(length)s Width:%(width)s Height:%(height)s "
        "Weight:%(weight)s} "
    ),
    "JavaScript": (
        "  Item {\n    name: '%(name)s',\n    position: [ %(x)s, %(y)s, %(z)s ],\n    length: %(length)s,\n"
        "    width: %(width)s,\n    height: %(height)s,\n    weight: %(weight)s,\n    sequence: undefined\n  },\n"
    ),
    "Java": (
        "Box[name=%(name)s, at=Point[x=%(x)s, y=%(y)s, z=%(z)s], length=%(length)s.0, width=%(width)s.0, "
        "height=%(height)s.0, weight=%(weight)s], "
    ),
    "C#": (
        "Box { Name = %(name)s, X = %(x)s, Y = %(y)s, Z = %(z)s, Length = %(length)s, Width = %(width)s, "
        "Height = %(height)s, Weight = %(weight)s }, "
    ),
    "Lua": (
        '{\n  ["name"] = "%(name)s",\n  ["position"] = { %(x)s, %(y)s, %(z)s },\n  ["length"] = %(length)s,\n'
        '  ["width"] = %(width)s,\n  ["height"] = %(height)s,\n  ["weight"] = %(weight)s\n},\n'
    ),
    "Clojure": (
        '{:name "%(name)s", :position [%(x)s %(y)s %(z)s], :length %(length)s, :width %(width)s, :height %(height)s, '
        ":weight %(weight)s}\n "
    ),
}
"""Language → the text of a box as its programs print it."""
LINE = (
    "Item: %(name)s, Position: (%(x)s, %(y)s, %(z)s), Dimensions: %(length)s x %(width)s x %(height)s, "
    "Weight: %(weight)s kg, Support: 100 %%"
)


def php(boxes: Sequence[dict[str, Any]]) -> str:
    """PHP's ``print_r`` of the boxes."""
    members = "".join(
        f"    [{number}] => Array\n        (\n"
        + "".join(f"            [{field}] => {value}\n" for field, value in box.items())
        + "        )\n\n"
        for number, box in enumerate(boxes)
    )
    return f"Array\n(\n{members})\n"


@pytest.mark.parametrize("language", [*PRINTED, "Kotlin", "PHP", "lines"])
def test_values_as_programs_print_them(language: str, tmp_path: Path) -> None:
    boxes = [dict(zip(("name", *FIELDS), (name, *box), strict=True)) for name, box in zip(NAMES, PILE, strict=True)]
    if language == "PHP":
        text = php(boxes)
    elif language == "Kotlin":
        text = "\n".join(f"Box({', '.join(map('{}={}'.format, box, box.values()))})" for box in boxes)
    elif language == "lines":
        text = "\n".join(("2 pallets, 1 used", *(LINE % box for box in boxes)))
    else:
        start, end = "{}" if language == "Lua" else "[]"
        text = f"{start}{''.join(PRINTED[language] % box for box in boxes)}{end}\n"
    plan_set = load(tmp_path, "pile.txt", text)
    assert not plan_set.skipped
    (plan,) = plan_set.plans
    check_pile(plan)
    assert language == "PHP" or plan.item_ids == tuple(NAMES)


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("[Box { x: 1, y: 2 }, Box { x: 3", "not readable at line 1, column 27 (a bracket is not closed)"),
        ("[Box { x: 1, y: 2 },\nBox { x: 3, x: 4 }]", "not readable at line 2, column 13 (x stands twice)"),
        ("{:pack [{:x 1 :y 2}}", "not readable at line 1, column 20 (} closes no bracket)"),
        ("[Box { x: 1, 5 }]", "not readable at line 1, column 7 (a value has no name)"),
        ("a: 1, x: 1, y: 2, z: 3, l: 4, w: 5\nb\n" + "a: 1, x: 1, y: 2, z: 3, l: 4, w: 5\n" * 2,
         "line 2: is no box: b"),
    ],
)  # fmt: skip
def test_damaged_printed_values_are_one_line(text: str, fault: str, tmp_path: Path) -> None:
    (skipped,) = load(tmp_path, "pile.txt", text).skipped
    assert skipped.message.endswith(fault)


def database(kind: str) -> str:
    """A dump of a database with the pile, or the result of a query."""
    columns = ", ".join(f"`{name}`" for name in ("box", *FIELDS))
    rows = [f"('{name}', {', '.join(map(str, box))})" for name, box in zip(NAMES, PILE, strict=True)]
    if kind == "COPY":
        lines = ["\t".join(map(str, named(k, list(map(float, box))))) for k, box in enumerate(PILE)]
        return "\n".join([f"COPY public.boxes ({', '.join(('box', *FIELDS))}) FROM stdin;", *lines, "\\.", ""])
    if kind == "INSERT":
        return f"INSERT INTO `boxes` ({columns}) VALUES\n{(',' + chr(10)).join(rows)};\n"
    if kind == "CREATE":
        created = ", ".join(f"`{name}` varchar(20) NOT NULL" for name in ("box", *FIELDS))
        inserts = "".join(f"INSERT INTO boxes VALUES {row};\n" for row in rows)
        return f"CREATE TABLE `boxes` ({created}, PRIMARY KEY (`box`));\n{inserts}"
    heads = {"MySQL": "***** {}. row *****", "PostgreSQL": "-[ RECORD {} ]-----", "INI": "[box{}]"}
    mark = {"MySQL": ": ", "PostgreSQL": " | ", "INI": "="}[kind]
    blocks = [
        "\n".join(
            [heads[kind].format(number), *map(mark.join, zip(("box", *FIELDS), (name, *map(str, box)), strict=True))]
        )
        for number, (name, box) in enumerate(zip(NAMES, PILE, strict=True), start=1)
    ]
    return "\n".join(["[pallet]\nkind=euro\n" if kind == "INI" else "", *blocks, ""]).lstrip()


@pytest.mark.parametrize("kind", ["INSERT", "CREATE", "COPY", "MySQL", "PostgreSQL", "INI"])
def test_databases_and_blocks_of_lines(kind: str, tmp_path: Path) -> None:
    text = database(kind)
    (plan,) = load(tmp_path, "pile.txt", text).plans
    check_pile(plan)
    assert plan.item_ids == tuple(NAMES)
    (skipped,) = load(tmp_path, "pile.txt", text.replace("7.75", "seven")).skipped
    assert skipped.message.endswith('weight must be a number, got "seven"')


def test_rows_of_a_dump_may_extend_over_several_lines(tmp_path: Path) -> None:
    text = database("INSERT").replace("(", "(\n  ").replace(", ", ",\n  ").replace(")", "\n)")
    check_pile(load(tmp_path, "dump.sql", text).plans[0])


def test_sections_of_a_table_may_have_titles_in_brackets(tmp_path: Path) -> None:
    rows = table(f"box,x,y,z,{SIZES},weight", named)
    plans = load(tmp_path, "pile.csv", f"[Pallet 1]\n{rows}[Pallet 2]\n{rows.partition(chr(10))[2]}").plans
    assert len(plans) == 2
    for plan in plans:
        check_pile(plan)


def test_damaged_dumps_are_one_line(tmp_path: Path) -> None:
    for text, fault in (
        (database("COPY").replace("\\.", ""), "line 1: the rows have no end; truncated?"),
        (database("INSERT").replace("('c'", "'c'"), "line 3: not a row of values"),
        (database("INI").replace("box=c", "= c"), "line 23: is no named value: = c"),
        (database("INI").replace("box=c", "box=c\nbox=d"), "line 24: its name stands twice: box=d"),
        ("INSERT INTO boxes VALUES ('a', 0);", "the names of the columns of boxes are missing"),
    ):
        (skipped,) = load(tmp_path, "dump.sql", text).skipped
        assert skipped.message.endswith(fault)


def message(box: Sequence[float], name: str) -> str:
    """A message of protocol buffers, in which zeros are not written."""
    fields = [" ".join(f"{axis}: {value}" for axis, value in zip(FIELDS[:3], box, strict=False) if value)]
    fields += [f"{field}: {value}" for field, value in zip(FIELDS[3:], box[3:], strict=True)]
    return f'boxes {{\n  name: "{name}: {{x"\n  at {{ {fields[0]} }}\n  ' + "\n  ".join(fields[1:]) + "\n}\n"


def test_messages_and_arrays(tmp_path: Path) -> None:
    text = 'plan_id: "P"\n' + "".join(message(box, name) for name, box in zip(NAMES, PILE, strict=True))
    (plan,) = load(tmp_path, "pile.textproto", text).plans
    check_pile(plan)
    assert plan.plan_id == "P"
    columns = zip(FIELDS, zip(*PILE, strict=True), strict=True)
    arrays = "% solved\n" + "".join(f"{name} = {list(values)};\n" for name, values in columns) + "----------\n"
    check_pile(load(tmp_path, "pile.txt", arrays).plans[0])
    (skipped,) = load(tmp_path, "pile.txt", arrays.replace("y = [0, ", "y = [")).skipped
    assert skipped.message.endswith("y has 7 values, but other lists have 8")


@pytest.mark.parametrize("kind", ["MongoDB", "DynamoDB", "Firestore", "figure", "UPS"])
def test_json_of_databases_and_figures(kind: str, tmp_path: Path) -> None:
    boxes = [dict(zip(("name", *FIELDS), (name, *box), strict=True)) for name, box in zip(NAMES, PILE, strict=True)]
    types = {"MongoDB": "$numberDouble", "DynamoDB": "N", "Firestore": "doubleValue"}
    value: Any
    if kind in types:
        texts = {"MongoDB": "$oid", "DynamoDB": "S", "Firestore": "stringValue"}
        typed = [
            {field: {texts[kind] if field == "name" else types[kind]: str(cell)} for field, cell in box.items()}
            for box in boxes
        ]
        value = {"documents": [{"fields": box} for box in typed]} if kind == "Firestore" else {"Items": typed}
    elif kind == "figure":  # corners of meshes
        ends = [[(box[axis], box[axis] + box[axis + 3]) for axis in range(3)] for box in PILE]
        corners = [list(zip(*product(*some), strict=True)) for some in ends]
        value = {"data": [dict(zip("xyz", some, strict=True)) for some in corners]}
    else:
        unit = {"UnitOfMeasurement": {"Code": "KGS", "Description": "Kilograms"}}
        value = {"Package": [{**box, "weight": {**unit, "Weight": box["weight"]}} for box in boxes]}
    (plan,) = load(tmp_path, "pile.json", json.dumps(value)).plans
    check_pile(plan, weights=kind != "figure")


def test_cells_of_a_web_page_over_several_rows(tmp_path: Path) -> None:
    head = "".join(f"<th>{name}</th>" for name in ("pallet", "box", *FIELDS))
    rows = ["".join(f"<td>{cell}</td>" for cell in named(k, list(map(float, box)))) for k, box in enumerate(PILE)]
    pallets = "".join(f"<tr><td rowspan='{len(PILE)}'>P{number}</td>{'</tr><tr>'.join(rows)}</tr>" for number in (1, 2))
    plans = load(tmp_path, "pile.html", f"<html><table><tr>{head}</tr>{pallets}</table></html>").plans
    assert [plan.plan_id for plan in plans] == ["P1", "P2"]
    for plan in plans:
        check_pile(plan)
    one_weight = rows[1].replace(f"<td>{float(PILE[1][6])}</td>", "")
    first = rows[0].replace(f"<td>{float(PILE[0][6])}", f"<td rowspan=2>{float(PILE[0][6])}")
    lines = "".join(f"<tr><td>P</td>{row}</tr>" for row in (first, one_weight, *rows[2:]))
    (skipped,) = load(tmp_path, "pile.html", f"<html><table><tr>{head}</tr>{lines}</table></html>").skipped
    assert skipped.message.endswith("row 3 (b): weight is missing")


def test_pallets_in_sections_and_messages(tmp_path: Path) -> None:
    sections = database("INI").replace("[pallet]\nkind=euro\n", "")
    text = "".join(f"[pallet{number}]\nkind=euro\n{sections}" for number in (1, 2))
    plans = list(load(tmp_path, "load.ini", text).plans)
    assert [plan.plan_id for plan in plans] == ["pallet1", "pallet2"]
    messages = [message(box, name) for name, box in zip(NAMES, PILE, strict=True)]
    text = f'pallet {{\n  id: "A"\n{"".join(messages)}}}\npallet {{\n  id: "B"\n{messages[0]}}}\n'
    a, b = load(tmp_path, "load.textproto", f"# two pallets\n{text}").plans
    assert (a.plan_id, b.plan_id, b.n_boxes) == ("A", "B", 1)
    for plan in (*plans, a):
        check_pile(plan)


def test_long_lines_of_marks_take_no_time() -> None:
    assert printed_values("#" * 200 + " pile\nbox,x,y,z\n") is None


def test_tables_of_boxes_that_are_not_placed(tmp_path: Path) -> None:
    dump = database("INSERT") + database("INSERT").replace("`boxes`", "unplaced_boxes")
    plan_set = load(tmp_path, "dump.sql", dump)
    check_pile(plan_set.plans[0])
    assert "8 boxes are not placed, and left out" in notes_of(plan_set)


def test_kinds_of_files_without_lists_of_boxes(tmp_path: Path) -> None:
    for text, kind in (
        ("#VRML V2.0 utf8\nTransform { translation 0 0 0 }\n", "is a scene in VRML"),
        ("# load\no box\nv 0 0 0\nv 400 0 0\n", "is a mesh (OBJ)"),
        ("/PROG PALLET\n/POS\nP[1]{ X = 0 mm };\n", "is a program of a robot"),
        ("translate([0, 0, 0]) cube([400, 300, 200]);\n", "is a model in OpenSCAD"),
        ("placed(400, 300, 200, 0, 0, 0).\n", "has facts (Prolog)"),
    ):
        (skipped,) = load(tmp_path, "pile.txt", text).skipped
        assert kind in skipped.message


DOCUMENTS = {
    "objects of a game engine": {"items": boxes_by(in_engine, "prefab")},
    "other objects of a scene": {"objects": in_a_scene()},
    "YAML": "# a recipe\npallet: {length: 1200, width: 800}\nlayers:\n" + "".join(
        f"- z: {z}\n  boxes:\n" + "".join(
            f"    - {{id: {name}, x: {box[0]}, y: {box[1]}, size: [{box[3]}, {box[4]}, {box[5]}], kg: {box[6]}}}\n"
            for name, box in zip(NAMES, PILE, strict=True) if box[2] == z)
        for z in (0, 300)),
    "blocks of YAML": "boxes:\n" + "".join(
        f"- pose:\n    position:\n      x: {box[0]}\n      y: {box[1]}\n      z: {box[2]}\n  size:\n  - {box[3]}\n"
        f"  - {box[4]}\n  - {box[5]}\n  mass: {box[6]}\n  'text': \"a # b\"\n" for box in PILE) + "---\n",
    "TOML": 'title = "a"\n' + "".join(
        f"[[box]]\nsize = {list(box[3:6])}\ncorner = {list(box[:3])}\nweight_kg = {box[6]}\n" for box in PILE),
    "far corners by their sides": boxes_by(lambda box: {
        "back_right_top": {axis: box[k] + box[k + 3] for k, axis in enumerate("xyz")}, **sized(box)}),
    "centres of bases beside a deck": {"container": {"length": 1200, "width": 800}, "boxes": boxes_by(
        lambda box: {**plain(box), "x": box[0] + box[3] / 2, "y": box[1] + box[4] / 2})},
    "scales of cubes": scene(),
    "a three.js scene": three_js(),
    "a shape in a list": {"collision_objects": boxes_by(in_lists)},
    "codes of units": boxes_by(lambda box: {
        **{name: {"value": value, "uom": "MMT"} for name, value in plain(box).items() if name != "weight"},
        "gross-weight": {"value": box[6], "uom": "KGM"}}),
    "lists by name": {"fields": list(FIELDS), "boxes": dict(zip(NAMES, map(list, PILE), strict=True))},
    "zeros are not written": boxes_by(lambda box: {
        "at": {axis: value for axis, value in zip("xyz", box, strict=False) if value}, **sized(box)}),
    "events": [{"event": "start", "pallet": {"length": 1200, "width": 800}},
               *({"event": "place", "box": box} for box in boxes_by(plain)), {"event": "end", "boxes": 8}],
    "extents that are half sizes": boxes_by(
        lambda box: {"Location": dict(zip("XYZ", centre(box), strict=True)), "MassKg": box[6],
                     "BoxExtent": dict(zip("XYZ", (side / 2 for side in box[3:6]), strict=True))}, ids="ActorLabel"),
    "data classes": "\n".join(
        f"Box(name='{NAMES[k]}', position=Point(x={x}, y={y}, z={z}), size=({length}, {width}, {height}), weight={kg})"
        for k, (x, y, z, length, width, height, kg) in enumerate(PILE)),
    "poses as text": "<sdf><world>" + "".join(
        f"<model name='{box['id']}'><pose>{' '.join(map(str, box['at']))} 0 0 1.5708</pose>"
        f"<link><mass>{box['kg']}</mass><box><size>{box['width']} {box['length']} {box['height']}</size></box></link>"
        "</model>"
        for box in boxes_by(lambda box: {**plain(box), "at": centre(box), "kg": box[6]})) + "</world></sdf>",
    "layers of one element": "<Pallet>" + "".join(
        f"<Layer z='{z}'>" + "".join(
            f"<Box x='{box[0]}' y='{box[1]}' length='{box[3]}' width='{box[4]}' height='{box[5]}' weight='{box[6]}'/>"
            for box in group) + "</Layer>"
        for z, group in ((0, PILE[:3]), (0, PILE[3:4]), (300, PILE[4:]))) + "</Pallet>",
    "matrices by columns": {"boxes": boxes_by(by_matrices)},
    "columns by labels": by_columns(),
    "units beside the boxes": with_units(),
    "units in the boxes": boxes_by(in_units),
    "free points in the boxes": {"containers": [{"placements": boxes_by(with_points)}]},
    "poses in the boxes": {"frame": "pallet", "collision_objects": boxes_by(with_pose)},
    "eight corners": {"boxes": boxes_by(lambda box: {"vertices": corners(box), "weight": box[6]})},
    "two points": {"boxes": boxes_by(lambda box: {"bbox": [corners(box)[0], corners(box)[7]], "weight": box[6]})},
    "near and far corners by words": {"placements": boxes_by(lambda box: {"kg": box[6], "position": {
        f"{end}Coordinates": dict(zip(("width", "depth", "height"), corners(box)[number], strict=True))
        for end, number in (("start", 0), ("end", 7))}})},
    "an article beside its boxes": {"spaces": [{
        "cargo": {"length": 1, "width": 2, "height": 3, "weight": box["weight"]},
        "placements": [{name: value for name, value in box.items() if name != "weight"}],
    } for box in boxes_by(plain)]},
    "articles with their places": {"pallet": {"length": 1200, "width": 800}, "articles": [
        {**{name: value for name, value in box.items() if name not in "xyz"}, "places": [
            {axis: box[axis] for axis in "xyz"}]} for box in boxes_by(plain)]},
    "bounds": {"boxes": boxes_by(lambda box: {"bbox": corners(box)[0] + corners(box)[7], "weight": box[6]})},
    "lists of angles": turned([0, 0, 90]),
    "rotation matrices": turned([[0, -1, 0], [1, 0, 0], [0, 0, 1]]),
    "poses of seven numbers": boxes_by(lambda box: {"pose": [*centre(box), 1, 0, 0, 0], **sized(box)}),
    "poses of six numbers": boxes_by(lambda box: {"pose": [*centre(box), 0, 0, 180], **sized(box)}),
    "poses of four numbers": boxes_by(lambda box: {"pose": [*centre(box), 0.0], **sized(box)}),
    "boxes in stacks": {"stacks": [{"boxes": [box]} for box in boxes_by(plain)]},
    "layers with z": layers(),
    "a unit of sizes alone": {"boxes": boxes_by(lambda box: {
        **dict(zip("xyz", box, strict=False)), "kg": box[6],
        "dims": {**dict(zip("lwh", (side / 10 for side in box[3:6]), strict=True)), "uom": "CMT"}})},
    "layers with heights": json.loads(
        json.dumps(layers()).replace('"z": 0', '"level": 1, "baseHeight": {"value": "0", "uom": "MMT"}')
        .replace('"z": 300', '"level": 2, "baseHeight": {"value": "30", "uom": "CMT"}')),
    "layers by keys": {"tool": "a", "layer_1": boxes_by(plain)[:4], "layer_2": boxes_by(plain)[4:]},
    "flags as numbers": {
        "boxes": [*({**box, "placed": 1} for box in boxes_by(plain)), {**boxes_by(plain)[0], "x": None, "placed": 0}]
    },
    "masses by their unit": boxes_by(lambda box: {"at": plain(box), "item": {"kg": box[6]}} | {"at": {
        name: value for name, value in plain(box).items() if name != "weight"}}),
    "units in German": boxes_by(
        lambda box: {**plain(box), "weight": {"value": box[6] * 1000, "Einheit": "g", "tara": 0}}
    ),
    "goals of moves": boxes_by(
        lambda box: {"size": box[3:6], "kg": box[6], "to": dict(zip("xyz", centre(box), strict=True))}
    ),
    "Python's values": printed(boxes_by(plain)),
    "Python's tuples": str({"boxes": tuple(boxes_by(plain))}),
    "XML": nested("Pallet", boxes_by(plain)),
}  # fmt: skip


@pytest.mark.parametrize("name", DOCUMENTS)
def test_documents_in_further_conventions(name: str, tmp_path: Path) -> None:
    content = DOCUMENTS[name]
    plan_set = load(tmp_path, "pile.json", content if isinstance(content, str) else json.dumps(content))
    assert not plan_set.skipped
    (plan,) = plan_set.plans
    check_pile(plan)


def test_x_may_be_the_vertical(tmp_path: Path) -> None:
    """The deck shows that x is the vertical. Without a deck, the user tells it."""
    boxes = [
        {"name": name, "origin": dict(zip("yzx", box[:3], strict=True)), "weight": box[6],
         "dimensions": dict(zip("yzx", box[3:6], strict=True))}
        for name, box in zip(NAMES, PILE, strict=True)
    ]  # fmt: skip
    content = json.dumps({"boxes": [{"box": {"dimensions": {"x": 2000, "y": 1200, "z": 800}, "items": boxes}}]})
    (plan,) = load(tmp_path, "pile.json", content).plans
    check_pile(plan)
    content = json.dumps({"items": boxes})
    (skipped,) = load(tmp_path, "pile.json", content).skipped
    assert "x upwards" in skipped.message
    assert "say which with --up (x, y, z, -y or -z)" in skipped.message
    (plan,) = load(tmp_path, "pile.json", content, up="x").plans
    check_pile(plan)


def test_rows_along_x_may_be_layers(tmp_path: Path) -> None:
    """Equal boxes stand along each axis, but they are listed by x, and not by z."""
    cells = [(x, y, z) for x in range(3) for y in range(2) for z in range(2)]
    rows = [{"x": 200 * x, "y": 250 * y, "z": 300 * z, "dx": 200, "dy": 250, "dz": 300} for x, y, z in cells]
    (skipped,) = load(tmp_path, "pile.json", json.dumps(rows)).skipped
    assert "say which with --up (x, y, z, -y or -z)" in skipped.message
    by_z = sorted(rows, key=lambda row: row["z"])
    (plan,) = load(tmp_path, "pile.json", json.dumps(by_z)).plans
    assert plan.size_mm[0].tolist() == [200, 250, 300]


def test_remarks_and_titles_between_boxes(tmp_path: Path) -> None:
    def load_with(line: str, place: int, above: str = "") -> petmjx.PlanSet:
        rows = [f"{name},{','.join(map(str, box))}" for name, box in zip(NAMES, PILE, strict=True)]
        rows[place:place] = [line]
        return load(tmp_path, "pile.csv", "\n".join([*filter(None, [above]), f"box,{','.join(FIELDS)}", *rows]))

    for remark in ("scan failed", "pallet checked", "load 50 % done"):
        plan_set = load_with(remark, 4)
        check_pile(plan_set.plans[0])
        assert f"row 6 is a remark, and left out: {remark}" in notes_of(plan_set)
    titled = load(
        tmp_path, "pile.csv", table(",".join(FIELDS)) + "Pallet 2\n" + table(",".join(FIELDS)).partition("\n")[2]
    )
    assert [plan.plan_id for plan in titled.plans] == ["pile/1", "Pallet 2"]
    assert "row 10 is a title: Pallet 2" in notes_of(titled)
    (skipped,) = load_with("d", 4).skipped
    assert skipped.message.endswith("row 6: is no box: d")
    (skipped,) = load_with("Lyon", 4, above="Report").skipped
    assert skipped.message.endswith("row 7: is no box: Lyon")


def test_lines_of_values_below_titles(tmp_path: Path) -> None:
    lines = [
        f"Item: {name}, Position: ({x}, {y}, {z}), Dimensions: {length} x {width} x {height}, Weight: {kg}, Layer: 1"
        for name, (x, y, z, length, width, height, kg) in zip(NAMES, PILE, strict=True)
    ]
    text = "\n".join(["Pallet 1:", *lines, "Pallet 2:", *lines, "Unplaced items:", lines[0]])
    plan_set = load(tmp_path, "pile.txt", text)
    for plan in plan_set.plans:
        check_pile(plan)
    assert [plan.plan_id for plan in plan_set.plans] == ["Pallet 1", "Pallet 2"]
    assert "1 box is not placed, and left out" in notes_of(plan_set)


def test_comments_behind_values(tmp_path: Path) -> None:
    fields = [
        f"{{ x: {x} /* mm */, y: {y} // left, at front\n, z: {z}, l: {length}, w: {width}, h: {height}, kg: {kg} }}"
        for x, y, z, length, width, height, kg in PILE
    ]
    check_pile(load(tmp_path, "pile.txt", f"[{', '.join(fields)}]").plans[0])


def test_eight_corners_may_have_small_errors(tmp_path: Path) -> None:
    rng = np.random.default_rng(33501)
    rows, boxes = [], []
    for box in PILE:
        ends = [(box[axis], box[axis] + box[axis + 3]) for axis in range(3)]
        corners = (np.array(list(product(*ends))) + rng.uniform(-0.5, 0.5, (8, 3))).round(2)
        rows.append([*corners.ravel(), box[6]])
        boxes.append({"corners": corners.tolist(), "weight": box[6]})
    header = ",".join(f"{axis}{corner} [mm]" for corner in range(1, 9) for axis in "xyz") + ",weight"
    (plan,) = load(tmp_path, "pile.csv", "\n".join([header, *(",".join(map(str, row)) for row in rows)])).plans
    (same,) = load(tmp_path, "pile.json", json.dumps(boxes)).plans
    for one in (plan, same):
        assert np.abs(one.size_mm - np.array(PILE)[:, 3:6]).max() < 1
    boxes[0]["corners"][0][0] += 4.5  # less than a hundredth of the longest side, but not of the shortest one
    (skipped,) = load(tmp_path, "pile.json", json.dumps(boxes)).skipped
    assert "which are not the corners of a level box" in skipped.message


def test_cells_of_a_grid(tmp_path: Path) -> None:
    """A box may be one cell thick, and there may be an empty cell between boxes."""
    header = "id,x1,y1,z1,x2,y2,z2,weight"

    def of_cells(*boxes: tuple[int, ...]) -> str:
        rows = [f"b{number},{','.join(map(str, box))},5" for number, box in enumerate(boxes)]
        return "\n".join([header, *rows])

    lower = [(0, 0, 0, 39, 29, 19), (41, 0, 0, 80, 29, 19), (0, 31, 0, 39, 60, 19), (41, 31, 0, 80, 60, 19)]
    upper = [(*box[:2], 21, *box[3:5], 40) for box in lower]
    (plan,) = load(tmp_path, "cells.csv", of_cells(*lower, (0, 0, 20, 80, 60, 20), *upper)).plans
    assert plan.size_mm[[0, 4]].tolist() == [[400, 300, 200], [810, 610, 10]]
    (skipped,) = load(tmp_path, "cells.csv", of_cells(*lower)).skipped
    assert 'say which with --columns ("last cells=NAME", or "last cells=-")' in skipped.message
    (plan,) = load(tmp_path, "cells.csv", of_cells(*lower), columns={"last cells": "x2"}).plans
    assert plan.size_mm[0].tolist() == [400, 300, 200]
    (plan,) = load(tmp_path, "cells.csv", of_cells(*lower), columns={"last cells": "-"}).plans
    assert plan.size_mm[0].tolist() == [390, 290, 190]
    (skipped,) = load(tmp_path, "cells.csv", of_cells(*lower), columns={"half extents": "x2"}).skipped
    assert skipped.message.endswith("x2 cannot hold half extents")
    (skipped,) = load(tmp_path, "ends.csv", of_cells((0, 0, 0, 40, 30, 0), (40, 0, 0, 80, 30, 20))).skipped
    assert skipped.message.endswith("row 2 (b0): z2 must be beyond z1, got 0")
    tiny = of_cells(*((x, y, z, x, y, z) for z in (0, 1) for y in (0, 1) for x in (0, 1, 2)))
    (skipped,) = load(tmp_path, "cells.csv", tiny).skipped
    assert "say which with --units" in skipped.message


def test_feet_are_a_unit_that_the_user_can_name(tmp_path: Path) -> None:
    in_feet = [dict(zip(FIELDS, [*(value / 304.8 for value in box[:6]), box[6]], strict=True)) for box in PILE]
    content = json.dumps({"placed": [{"id": name, **box} for name, box in zip(NAMES, in_feet, strict=True)]})
    (plan,) = load(tmp_path, "pile.json", content, up="z", units="ft,kg").plans
    check_pile(plan)


def test_sizes_in_another_unit_than_places(tmp_path: Path) -> None:
    """Only the places name their unit."""
    header = "SKU,Length,Width,Height,X (cm),Y (cm),Z (cm)"
    content = table(header, lambda k, box: [NAMES[k], *box[3:6], *(value / 10 for value in box[:3])])
    plan_set = load(tmp_path, "pile.csv", content)
    check_pile(plan_set.plans[0], weights=False)
    assert "sizes in mm, coordinates in cm" in notes_of(plan_set)
    check_pile(load_again(tmp_path / "pile.csv", plan_set), weights=False)
    without_units = load(tmp_path, "pile.csv", content.replace(" (cm)", ""))
    check_pile(load_again(tmp_path / "pile.csv", without_units), weights=False)


def load_again(file: Path, plan_set: petmjx.PlanSet) -> petmjx.Plan:
    """The plan of a file by the written reading of an earlier load."""
    ((source, reading),) = plan_set.readings.items()
    written = file.with_name("reading.toml")
    written.write_text(reading_toml(reading, source))
    (plan,) = petmjx.load_plans(file, reading=written).plans
    return plan


def test_weights_of_another_list_belong_to_boxes_of_the_same_sizes(tmp_path: Path) -> None:
    items = [{"id": name, **dict(zip(FIELDS[3:], box[3:], strict=True))} for name, box in zip(NAMES, PILE, strict=True)]
    boxes = [{name: value for name, value in box.items() if name != "weight"} for box in boxes_by(plain)]
    plan_set = load(tmp_path, "pile.json", json.dumps({"cargo": items, "placed": boxes}), up="z", units="mm")
    check_pile(plan_set.plans[0])
    assert "weights from cargo[]" in notes_of(plan_set)
    items[0] |= {"height": 310, "length": 500}
    items[1] |= {"height": 310}
    other_sizes = load(tmp_path, "other.json", json.dumps({"cargo": items, "placed": boxes}), up="z", units="mm")
    assert "no weights: 300 kg/m³" in notes_of(other_sizes)


def test_a_written_reading_keeps_that_parts_are_one_plan(tmp_path: Path) -> None:
    """The containers of a program are spaces of one pallet."""
    boxes = boxes_by(plain)
    groups = [{"name": "lower", "places": boxes[:4]}, {"name": "upper", "places": boxes[4:]}]
    plan_set = load(tmp_path, "pile.json", json.dumps({"containers": groups}), up="z", units="mm")
    assert "are read as one plan: as separate plans, some would float above the deck" in notes_of(plan_set)
    check_pile(plan_set.plans[0])
    check_pile(load_again(tmp_path / "pile.json", plan_set))


def test_a_box_below_the_deck_is_named(tmp_path: Path) -> None:
    low = boxes_by(plain)
    low[6]["z"] = -300.0
    (skipped,) = load(tmp_path, "pile.json", json.dumps(low), up="z", anchor="corner").skipped
    assert skipped.message.endswith("[6] (g): z is below the deck, on which other boxes stand, got -300")


def test_lines_around_numbers_without_a_header(tmp_path: Path) -> None:
    """The first line may have words, or the sizes of the container. A column may separate pallets."""
    rows = "".join(" ".join(map(str, box[:6])) + "\n" for box in PILE)
    for above in ("solved\n", "1200 800 1500\n"):
        plan_set = load(tmp_path, "pile.txt", above + rows, up="z", units="mm")
        check_pile(plan_set.plans[0], weights=False)
        assert f"row 1 is no box: {above.strip()}" in notes_of(plan_set)
    trucks = "solved\n" + "".join(f"{truck} {' '.join(map(str, two_corners(box)))}\n" for truck in "01" for box in PILE)
    (skipped,) = load(tmp_path, "trucks.txt", trucks, units="mm").skipped
    assert "boxes overlap, but not if column 1 separates pallets; say which with --columns" in skipped.message
    for plan in load(tmp_path, "trucks.txt", trucks, units="mm", columns={"plan": "column 1"}).plans:
        check_pile(plan, weights=False)


REPORT = """
*** REPORT ***
WHILE PALLET ORIENTATION  : X=1200; Y=800; Z=1500
---------------------------------------------------------
  NO: DIM-1 DMEN-2 DMEN-3 COOR-X COOR-Y COOR-Z PACKEDX PACKEDY PACKEDZ
---------------------------------------------------------
"""


def test_sizes_beside_places_and_boxes_that_are_not_placed(tmp_path: Path) -> None:
    rows = "".join(
        f"{number:5d} {box[5]:6d} {box[3]:6d} {box[4]:6d} "
        f"{' '.join(f'{value:6d}' for value in (*box[:3], *box[3:6]))}\n"
        for number, box in enumerate(PILE, start=1)
    )
    unplaced = "\n *** LIST OF UNPACKED BOXES ***\n    9   300   200   100\n   10   300   200   100\n"
    plan_set = load(tmp_path, "report.txt", REPORT + rows + unplaced, up="z", units="mm")
    check_pile(plan_set.plans[0], weights=False)
    assert "2 boxes are not placed, and left out" in notes_of(plan_set)


def test_text_of_bp3d_has_letters_of_rotations_and_empty_bins(tmp_path: Path) -> None:
    """Sizes are width, height and depth; x, y and z are their axes, and y is the vertical."""
    rows = []
    for name, (x, y, z, length, width, height, kg) in zip(NAMES, PILE, strict=True):
        sizes, turn = ((width, length), "DHW (d,h,w)") if name in "beh" else ((length, width), "WHD (w,h,d)")
        first, last = sizes
        rows.append(f"   {name}({first}x{height}x{last}, weight: {kg}) pos({x},{z},{y}) rt(RotationType_{turn})\n")
    text = "Small(10x15x20, max_weight:100)\n packed items:\nEuro(1200x1500x800, max_weight:1000)\n packed items:\n"
    (plan,) = load(tmp_path, "pile.txt", text + "".join(rows)).plans
    check_pile(plan)


def test_scenes_without_weights_or_with_meshes_that_are_scaled(tmp_path: Path) -> None:
    plan_set = load(tmp_path, "scene.json", json.dumps(three_js(instances=True)))
    check_pile(plan_set.plans[0], weights=False)
    assert "left out: 1 mesh that is no box" in notes_of(plan_set)
    check_pile(load(tmp_path, "scene.gltf", json.dumps(gltf())).plans[0])


def test_boxes_in_a_tuple_are_those_in_a_list() -> None:
    objects: Any = {"pallets": ({"boxes": tuple(boxes_by(plain))},)}
    (plan,) = petmjx.load_plans(objects).plans
    check_pile(plan)


def test_stacks_give_their_places(tmp_path: Path) -> None:
    (plan,) = load(tmp_path, "pile.json", json.dumps(stacks())).plans
    order = [NAMES.index(name) for name in plan.item_ids]
    np.testing.assert_allclose(plan.corner_mm, np.array(PILE)[order, :3])


def test_fields_of_several_numbers(tmp_path: Path) -> None:
    fields = [("name", "U4"), ("pos", "f8", (3,)), ("dim", [("l", "f8"), ("w", "f8"), ("h", "f8")]), ("kg", "f4")]
    rows = [(name, box[:3], box[3:6], box[6]) for name, box in zip(NAMES, PILE, strict=True)]
    np.save(tmp_path / "pile.npy", np.array(rows, dtype=fields))
    at = [dict(zip("xyz", map(float, box), strict=False)) for box in PILE]
    columns = {"name": list(NAMES), "position": at, "size": [list(map(float, box[3:6])) for box in PILE]}
    pq.write_table(pa.table({**columns, "weight": [float(box[6]) for box in PILE]}), tmp_path / "pile.parquet")
    for file in ("pile.npy", "pile.parquet"):
        (plan,) = petmjx.load_plans(tmp_path / file).plans
        check_pile(plan)
        assert plan.item_ids == tuple(NAMES)


def test_a_damaged_text_of_an_array_is_named(tmp_path: Path) -> None:
    array = np.array([(name, *box) for name, box in zip(NAMES, PILE, strict=True)],
                     dtype=[("name", "U4"), *((field, "f8") for field in FIELDS)])  # fmt: skip
    np.save(tmp_path / "pile.npy", array)
    content = bytearray((tmp_path / "pile.npy").read_bytes())
    begin = len(content) - array.itemsize
    content[begin : begin + 4] = b"\xff" * 4
    (skipped,) = load(tmp_path, "pile.npy", bytes(content)).skipped
    assert skipped.message.endswith("row 7: name is damaged")


def test_bodies_of_one_load(tmp_path: Path) -> None:
    bodies = "".join(
        f'<body name="{NAMES[k]}" pos="{x / 1e3} {y / 1e3} {z / 1e3}"><geom type="box" mass="{box[6]}" '
        f'size="{box[3] / 2e3} {box[4] / 2e3} {box[5] / 2e3}"/></body>'
        for k, box in enumerate(PILE)
        for x, y, z in [centre(list(map(float, box)))]
    )
    pallet = '<body name="pallet" pos="0 0 .1"><freejoint/><geom type="box" size=".6 .4 .05" pos=".6 .4 -.05"/>'
    scene = f"<mujoco><worldbody>{pallet}{bodies}</body></worldbody></mujoco>"
    (plan,) = load(tmp_path, "scene.xml", scene).plans
    check_pile(plan)


def test_an_implausible_reading_of_an_unusual_kind_is_asked_about(tmp_path: Path) -> None:
    """The places are those of middles of sides, which petmjx does not try. As centres, boxes overlap."""
    row = lambda k, box: [NAMES[k], box[0], box[1] + box[4] / 2, box[2] + box[5] / 2, *box[3:]]  # noqa: E731
    (skipped,) = load(tmp_path, "pile.csv", table(f"name,x,y,z,{SIZES},mass", row)).skipped
    assert "no reading is plausible; the best are" in skipped.message


@pytest.mark.parametrize("axes", ["x", "y", "xy", "z", "xz", "yz"])
def test_places_may_be_those_of_any_corner(tmp_path: Path, axes: str) -> None:
    """As corners with the smallest x and z, few boxes of the pile overlap if y is the largest, so petmjx asks."""

    def row(number: int, box: list[float]) -> list[Any]:
        return [NAMES[number], *(box[k] + box[k + 3] * (axis in axes) for k, axis in enumerate("xyz")), *box[3:]]

    text = table(f"name,x,y,z,{SIZES},mass", row)
    for options in ({"anchor": f"corner-{axes}"}, {}):
        plan_set = load(tmp_path, "pile.csv", text, **options)
        for plan in plan_set:
            check_pile(plan)
        assert plan_set.plans or (
            not options and f"corners with the largest {' and '.join(axes)} (" in str(plan_set.skipped)
        )


@pytest.mark.parametrize("up", "xyz")
def test_a_flat_layer_is_not_read_as_a_wall(tmp_path: Path, up: str) -> None:
    """Six boxes on the deck, one row of which is shorter, so that a wall of them would not float."""
    order = {"z": (0, 1, 2), "y": (0, 2, 1), "x": (2, 0, 1)}[up]
    boxes = [(400 * (k % 3), 400 * (k // 3), 0, 400, 400 - 100 * (k // 3), 150) for k in range(6)]
    rows = [[box[axis] for axis in order] + [box[axis + 3] for axis in order] for box in boxes]
    text = "\n".join(["X,Y,Z,Size X,Size Y,Size Z", *(",".join(map(str, row)) for row in rows)])
    plan_set = load(tmp_path, "layer.csv", text, units="mm")
    assert bool(plan_set.plans) == (up == "z")
    np.testing.assert_allclose([plan.corner_mm[:, 2] for plan in plan_set], 0)
    assert all("can be read in two ways" in skipped.message for skipped in plan_set.skipped)
    (plan,) = load(tmp_path, "layer.csv", text, units="mm", up=up).plans
    np.testing.assert_allclose(plan.corner_mm[:, 2], 0)


@pytest.mark.parametrize(("up", "is_asked"), [("z", True), ("y", False)])
def test_a_block_that_may_stand_on_another_side_is_asked_or_both_verticals_are_named(
    tmp_path: Path, up: str, is_asked: bool
) -> None:
    """Equal boxes listed stack by stack. The order speaks for y if z is upwards, and for z if y is upwards."""
    size = (500, 380, 220)
    boxes = [(500 * x, 380 * y, 220 * z) for y, x, z in np.ndindex(4, 3, 2)]
    order = {"z": (0, 1, 2), "y": (0, 2, 1)}[up]
    rows = [[*(box[axis] for axis in order), *(size[axis] for axis in order), 9] for box in boxes]
    text = "x,y,z,dx,dy,dz,mass\n" + "".join(",".join(map(str, row)) + "\n" for row in rows)
    plan_set = load(tmp_path, "block.csv", text, units="mm,kg")
    if is_asked:
        assert "say which with --up" in str(plan_set.skipped)
    else:
        (reading,) = plan_set.readings.values()
        assert reading.up == "z"
        assert "y may be upwards, too (--up)" in reading.notes
    (plan,) = load(tmp_path, "block.csv", text, units="mm,kg", up=up).plans
    assert plan.size_mm[:, 2].tolist() == [220] * 24


def test_the_order_of_py3dbp_does_not_decide_which_axis_is_vertical(tmp_path: Path) -> None:
    """py3dbp fills a container along x, then y, then z, whichever axis is the vertical."""
    rows = [f"b,200,300,250,6,{200 * x},{300 * y},{250 * z},0" for z, y, x in np.ndindex(3, 2, 3)]
    text = "\n".join(["name,width,height,depth,weight,x,y,z,rotation_type", *rows])
    (skipped,) = load(tmp_path, "packed.csv", text, units="mm,kg").skipped
    assert "say which with --up" in skipped.message


def test_a_flat_layer_of_positions_rotations_and_scales_has_y_upwards(tmp_path: Path) -> None:
    places = [[200 + 400 * (k % 3), 100, 150 + 300 * (k // 3)] for k in range(6)]
    boxes = [{"position": place, "rotation": [0, 0, 0], "scale": [400, 200, 300]} for place in places]
    (reading,) = load(tmp_path, "layer.json", json.dumps(boxes), units="mm").readings.values()
    assert reading.up == "y"


def test_a_container_may_be_a_list_of_length_width_and_height_beside_coordinates_with_y_upwards(tmp_path: Path) -> None:
    boxes = [
        {"size": [600, 500, 400], "position": [600 * (k % 2), 500 * (k // 4), 400 * (k // 2 % 2)]} for k in range(12)
    ]
    (plan,) = load(tmp_path, "load.json", json.dumps({"container": [1200, 800, 1500], "boxes": boxes})).plans
    assert plan.size_mm[0].tolist() == [600, 400, 500]


@pytest.mark.parametrize("anchor", ["corner-x", "corner-y", "corner-z"])
def test_corners_are_also_considered_if_x_is_upwards(tmp_path: Path, anchor: str) -> None:
    point = np.array(ANCHORS[anchor])
    rows = [
        [*(np.array([z, x, y]) + point * [height, length, width]), height, length, width, kg]
        for x, y, z, length, width, height, kg in PILE
    ]
    text = "x,y,z,dx,dy,dz,kg\n" + "".join(",".join(map(str, row)) + "\n" for row in rows)
    for plan in load(tmp_path, "load.csv", text, units="mm,kg"):
        assert plan.size_mm[:, 2].tolist() == [box[5] for box in PILE]


def test_lengths_above_widths_are_those_of_items(tmp_path: Path) -> None:
    """Boxes with gaps, so that they fit both as given and turned. Every second one is turned."""
    rows = [f"{500 * (k % 2)},{500 * (k // 2 % 3)},{200 * (k // 6)},400,300,200,{k % 2},6" for k in range(12)]
    text = "\n".join(["x,y,z,length,width,height,rotated,mass", *rows])
    (plan,) = load(tmp_path, "load.csv", text, units="mm,kg").plans
    assert plan.size_mm[:2].tolist() == [[400, 300, 200], [300, 400, 200]]


def test_the_container_beside_a_list_shows_the_vertical(tmp_path: Path) -> None:
    for deck, up, order in (((1200, 1500, 800), "y", (0, 2, 1)), ((1200, 800, 1500), "z", (0, 1, 2))):
        places = [(400 * (k % 3), 400 * (k // 3 % 2), 400 * (k // 6)) for k in range(12)]
        item = {"rotationType": 0, "WHD": [400, 400, 400], "weight": 9}
        items = [
            {"partNumber": k, **item, "position": [place[axis] for axis in order]} for k, place in enumerate(places)
        ]
        answer = {"data": {"box": [{"partNumber": "pallet", "WHD": deck}], "fitItem": items}}
        (reading,) = load(tmp_path, "answer.json", json.dumps(answer), units="mm").readings.values()
        assert reading.up == up


def test_bins_of_a_certificate_are_pallets_with_their_sizes(tmp_path: Path) -> None:
    """Only the bins, 48 × 40 inches, show that lengths are not centimetres. The items have decimal commas."""
    rows = [f"ITEM,0,1,{k},{x},0,0,10.5,20,12,XYZ" for k in range(2) for x in (0, 10.5)]
    rows[0:0], rows[3:3] = ["BIN,0,1,0,0,0,0,48,40,60,"], ["BIN,0,1,1,0,0,0,48,40,60,"]
    (tmp_path / "items.csv").write_text("X;Y;Z;COPIES;WEIGHT\n10,5;20;12;4;5,5\n")
    text = "\n".join(["TYPE,ID,COPIES,BIN,X,Y,Z,LX,LY,LZ,ROTATION", *rows])
    one, two = load(tmp_path, "certificate.csv", text, units="kg").plans
    assert (one.plan_id, two.plan_id) == ("certificate/0", "certificate/1")
    np.testing.assert_allclose(two.size_mm, [[266.7, 508, 304.8]] * 2)
    np.testing.assert_allclose(two.mass_kg, 5.5)


def test_one_dash_below_a_narrow_column(tmp_path: Path) -> None:
    head = "id  bin-location  orientation    x    y  z   x'   y'   z'\n"
    head += "--  ------------  -----------  ---  ---  -  ---  ---  ---\n"
    lines = [f" {k}             1            1  {400 * k:3}    0  0  400  300  200" for k in range(2)]
    (plan,) = load(tmp_path, "solution.txt", head + "\n".join(lines)).plans
    np.testing.assert_allclose(plan.corner_mm, [[0, 0, 0], [400, 0, 0]])


JSON_LINES = [json.dumps({"id": NAMES[k], **dict(zip(FIELDS, box, strict=True))}) for k, box in enumerate(PILE)]


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("pile.json", f'// pallet\n{{"boxes": [ // first\n{", /* next */".join(JSON_LINES)},]}}'),
        ("pile.json5", "// pallet\n[" + ",".join(re.sub(r'"(\w+)":', r"\1:", line) for line in JSON_LINES) + ",]"),
        (
            "pile.edn",
            ";; pallet\n{:boxes [" + " ".join(re.sub(r'"(\w+)":', r":\1", line) for line in JSON_LINES) + "]}",
        ),
    ],
)
def test_comments_in_nested_values(tmp_path: Path, name: str, text: str) -> None:
    check_pile(load(tmp_path, name, text).plans[0])


def test_damage_in_json_with_comments_is_named(tmp_path: Path) -> None:
    text = "// pallet\n[" + ", // box\n".join(JSON_LINES) + "]"
    (skipped,) = load(tmp_path, "pile.json", text.replace('"weight": 6.5', '"weight": 6q5', 1)).skipped
    assert "not JSON at line 6, column " in skipped.message
    began = time.process_time()
    assert load(tmp_path, "long.json", "[" + "/*" * 100_000).skipped
    assert load(tmp_path, "long.json", "[" + ", " * 100_000).skipped
    assert time.process_time() - began < 5.0


def test_an_empty_attribute_of_a_scene_is_named(tmp_path: Path) -> None:
    body = '<body pos="0 0 .1"><freejoint/><geom type="box" size=".2 .2 .1" mass=""/></body>'
    (skipped,) = load(tmp_path, "scene.xml", f"<mujoco><worldbody>\n{body}</worldbody></mujoco>").skipped
    assert skipped.message.endswith("line 2: mass is missing")


@pytest.mark.parametrize(
    ("cell", "value", "unit"),
    [
        ("23 5/8", 23.625, ""),
        ('3/4"', 0.75, "in"),
        ("1-1/2 in", 1.5, "in"),
        ("1'-9 3/16\"", 21.1875, "in"),
        ("-2' 1/2\"", -24.5, "in"),
        ("1 ft 2 1/4 in", 14.25, "in"),
    ],
)
def test_fractions_of_inches(cell: str, value: float, unit: str) -> None:
    assert cell_number(cell) == (value, unit)
    assert cell_number(cell.replace("/", "/7")) is None


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("boxes:\n- x: 1\n  y: 2\n - z: 3\n", "not YAML at line 4 (its indent fits no line above)"),
        ("a: 1\nb: [1, {c: 2\nd: 3\n", "not YAML at line 2 (a bracket is not closed)"),
        ("a: 1\nb: 2\nb: 3\n", "not YAML at line 3 (b occurs twice)"),
        ('a: 1\nb: "\\q"\nc: 3\n', "not YAML at line 2 (unknown escape \\q)"),
        ('a: 1\nb: "\\UFFFFFFFF"\nc: 3\n', "not YAML at line 2 (unknown escape \\UFFFFFFFF)"),
        ("a: &b 1\nc: 2\nd: 3\n", "not YAML at line 1 (petmjx does not read values that begin with &)"),
        ("a: 1\nb: 2\nc: 3\n", "is YAML without a list of boxes"),
        ("[[box]]\nx = 1\ny = \n", "not TOML: "),
    ],
)
def test_damaged_yaml_and_toml_are_one_line(text: str, fault: str, tmp_path: Path) -> None:
    (skipped,) = load(tmp_path, "pile.yaml", text).skipped
    assert fault in skipped.message
    assert "\n" not in skipped.message


def test_names_in_lists_and_escapes_of_yaml(tmp_path: Path) -> None:
    """In YAML 1.1, "no" is false; in a list of names, it is a name."""
    text = (
        'sku: [no, "\\u00e4\\x41\\tb"]\nid:\n- 0012\n- 1e5\nx: [0, 400]\ny: [0, 0]\nz: [0, 0]\nlength: [400, 400]\n'
        "width: [300, 300]\nheight: [200, 200]\nweight: [5, 6]\n"
    )
    (plan,) = load(tmp_path, "pile.yaml", text, up="z", units="mm").plans
    assert plan.articles == ("no", "äA\tb")
    assert plan.item_ids == ("0012", "1e5")


FLOW = "x: 0, y: 0, length: 400, width: 300, height: 200, weight: 5"


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("pile.yaml", f"boxes: [{{z: 0, {FLOW}}}, {{z: 200, {FLOW}}}]\n"),
        ("pile.yml", f"boxes:\n- {{z: 0, {FLOW}}}\n- {{z: 200, {FLOW}}}\n"),
        ("pile.YAML", f"- {{z: 0, {FLOW}}}\n- {{z: 200, {FLOW}}}\n"),
        ("pile.yaml", f"{{boxes: [{{z: 0, {FLOW}}},\n  {{z: 200, {FLOW}}}]}}\n"),
        ("pile.yaml", f"\n  boxes:\n    - {{z: 0, {FLOW}}}\n    - {{z: 200, {FLOW}}}\n"),
        ("pile.toml", f"boxes = [\n  {{z: 0, {FLOW}}},\n  {{z: 200, {FLOW}}},\n]\n".replace(":", " =")),
        ("pile.toml", f"[plans.p1]\nboxes = [\n  {{z: 0, {FLOW}}},\n  {{z: 200, {FLOW}}},\n]\n".replace(":", " =")),
    ],
)
def test_short_yaml_and_toml_are_recognised_by_the_name_of_the_file(name: str, text: str, tmp_path: Path) -> None:
    plan_set = load(tmp_path, name, text)
    (plan,) = plan_set.plans
    assert plan.corner_mm.tolist() == [[0, 0, 0], [0, 0, 200]]
    assert notes_of(plan_set).startswith(f"read as {'TOML' if name == 'pile.toml' else 'YAML'};")


@pytest.mark.parametrize(
    ("name", "text", "fault"),
    [
        ("pile.yaml", f"boxes:\n- {{z: 0, {FLOW}, weight: 7}}\n", "not YAML at line 2 (weight occurs twice)"),
        ("pile.yaml", f"boxes: [{{z: 0, {FLOW}}}\n", "not YAML at line 1 (a bracket is not closed)"),
        ("pile.yml", "x,y,z\n0,0,0\n", "not YAML at line 2 (its indent fits no line above)"),
        ("pile.toml", "boxes = [\n  {x = 0},\n", "not TOML: Invalid value (at line 2, the end of the file)"),
        ("pile.toml", "boxes = [\n  {x = 0, y},\n]\n", "(at line 2, column "),
        ("pile.toml", f"boxes = {'[' * 20_000}", "not TOML: lists or tables are nested too deeply"),
        ("pile.yaml", "\n", "the file is empty"),
    ],
)
def test_a_file_named_yaml_or_toml_gets_the_fault_of_its_format(
    name: str, text: str, fault: str, tmp_path: Path
) -> None:
    (skipped,) = load(tmp_path, name, text).skipped
    assert fault in skipped.message


@pytest.mark.parametrize(
    ("written", "read"),
    [
        ("Bob's", "Bob's"),
        ('5" box', '5" box'),
        ("a#1", "a#1"),
        ('"a # b"', "a # b"),
        ("'Bob''s # 1'", "Bob's # 1"),
        ("00123", "00123"),
        ("1e5", "1e5"),
        ("1.10", "1.10"),
        ("no", "no"),
        ("off", "off"),
        ("Yes", "Yes"),
    ],
)
def test_names_and_ids_of_yaml_are_read_as_written(written: str, read: str, tmp_path: Path) -> None:
    block = f"boxes:\n- sku: {written} # it's\n  z: 0\n  " + FLOW.replace(", ", "\n  ")
    for text in (block, f"boxes:\n- {{sku: {written}, z: 0, {FLOW}}} # it's 5\"\n"):
        (plan,) = load(tmp_path, "pile.yaml", text).plans
        assert plan.articles == (read,)


@pytest.mark.parametrize(
    ("text", "kind"),
    [
        ('#usda 1.0\n(\n    upAxis = "Z"\n)\n', "is a scene in USD: save it as glTF"),
        ("MODULE PalletData\n  CONST num n:=3;\nENDMODULE\n", "is a program of a robot: plans are JSON"),
        ("def place():\n  movel(p[0.1,0.2,0.3,0,3.14,0], a=1.2)\nend\n", "is a program of a robot: plans are JSON"),
    ],
)
def test_texts_of_other_programs_are_named(text: str, kind: str, tmp_path: Path) -> None:
    (skipped,) = load(tmp_path, "pile.txt", text).skipped
    assert kind in skipped.message


def test_sizes_are_not_exchanged_where_places_are_those_of_another_corner(tmp_path: Path) -> None:
    """With the height and the length along y exchanged, no box of this layer overlaps or floats, either."""
    rows = [(0, 0, 600, 400), (600, 0, 200, 400), (800, 0, 400, 400), (0, 400, 300, 200), (300, 400, 200, 200)]
    rows += [(500, 400, 700, 200), (0, 600, 600, 200), (600, 600, 600, 200)]
    boxes = [
        {"x": x, "y": y + length, "z": 0, "dx": width, "dy": length, "dz": 200, "weight": 4}
        for x, y, width, length in rows
    ]
    (tmp_path / "layer.json").write_text(json.dumps({"boxes": boxes}))
    (plan,) = petmjx.load_plans(tmp_path / "layer.json").plans
    np.testing.assert_allclose(plan.size_mm, [(width, length, 200) for *_, width, length in rows])


def test_centres_of_bases_are_not_taken_for_corners(tmp_path: Path) -> None:
    """Two loads from the corner of the deck, and one in its middle: no names tell that the places are those of centres
    of bases, or of tops."""
    for top in (0, 1):
        for shift in ((0, 0), (600, 400)):
            text = table(
                f"name,x,y,z,{SIZES},mass",
                lambda k, box, top=top, shift=shift: [
                    NAMES[k],
                    *(at - off for at, off in zip(centre(box)[:2], shift, strict=True)),
                    box[2] + top * box[5],
                    *box[3:],
                ],
            )
            (plan,) = load(tmp_path, "pile.csv", text).plans
            np.testing.assert_allclose(plan.corner_mm - plan.corner_mm.min(axis=0), np.array(PILE)[:, :3], atol=0.05)


def test_values_that_would_be_lost_in_silence_are_named(tmp_path: Path) -> None:
    """A decimal comma in a list makes a fourth number, and a missing cell of a printed table moves the other cells."""
    recipe = DOCUMENTS["TOML"].replace("corner = [0, 300, 300]", "corner = [0, 300, 300,5]")
    (skipped,) = load(tmp_path, "pile.toml", recipe).skipped
    assert 'box[6]: corner[2] must be a number, got "300 and a further number"' in skipped.message
    report = in_pages().replace("      350", "     ")
    (skipped,) = load(tmp_path, "pile.txt", report).skipped
    assert "row 21: has 7 fields instead of 8" in skipped.message


def test_a_height_below_the_floor_does_not_turn_the_pile(tmp_path: Path) -> None:
    wrong = table(f"name,x,y,z,{SIZES},mass", lambda k, box: [NAMES[k], *box[:2], -310 if k == 7 else box[2], *box[3:]])
    (skipped,) = load(tmp_path, "pile.csv", wrong).skipped
    assert skipped.message.endswith("row 9 (h): z is below the deck, on which other boxes stand, got -310")


def test_pallets_in_an_array_of_their_own(tmp_path: Path) -> None:
    pile = np.array([*PILE, *PILE], float)
    pallet = np.repeat([1, 2], len(PILE))
    np.savez(tmp_path / "pile.npz", size=pile[:, 3:6], corner=pile[:, :3], mass=pile[:, 6], pallet=pallet)
    for plan in petmjx.load_plans(tmp_path / "pile.npz").plans:
        check_pile(plan)


def test_pairs_of_sizes_and_places_in_an_array(tmp_path: Path) -> None:
    pile = np.array(PILE, float)
    np.save(tmp_path / "pile.npy", np.stack([pile[:, 3:6], pile[:, :3]], axis=1))
    (plan,) = petmjx.load_plans(tmp_path / "pile.npy").plans
    check_pile(plan, weights=False)


# Several plans.


def sheets(**rows: Sequence[Sequence[Any]]) -> bytes:
    book, content = openpyxl.Workbook(), io.BytesIO()
    book.remove(book.active)
    for title, cells in rows.items():
        sheet = book.create_sheet(title)
        for row in cells:
            sheet.append(list(row))
    book.save(content)
    return content.getvalue()


BOX_ROWS = [["box", *FIELDS], *(named(number, list(box)) for number, box in enumerate(PILE))]


@pytest.mark.parametrize(
    ("name", "content", "plans"),
    [
        ("by name.json", {"A": {"boxes": boxes_by(plain)}, "B": {"boxes": boxes_by(plain)}}, ("A", "B")),
        ("by id.json", {"A": {"boxes": {box["id"]: box for box in boxes_by(plain)}},
                        "B": {"boxes": {box["id"]: box for box in boxes_by(plain)}}}, ("A", "B")),
        ("numbered.json", {"tool": "a", "pallet_1": boxes_by(plain), "pallet_2": boxes_by(plain)},
         ("pallet_1", "pallet_2")),
        ("remarks.xlsx", sheets(A=BOX_ROWS, B=[[*row, "remark"] for row in BOX_ROWS]), ("A", "B")),
        ("titles.csv", table(f"box;x;y;z;{SIZES.replace(',', ';')};weight".replace(";", ","), named, mark=";")
         .replace("a;", "Pallet A;Customer: X;;;;;;\na;", 1) + "Pallet;2;Weight;63 kg;;;;\n"
         + table("", named, mark=";").partition("\n")[2], ("Pallet A", "Pallet 2")),
        ("types of rows.csv", table(f"type,name,x,y,z,{SIZES},weight", lambda k, box: ["box", *named(k, box)])
         .replace("box,a", "pallet,A,0,0,-100,1200,800,100,20\nbox,a", 1) + "pallet,B,0,0,-100,1200,800,100,20\n"
         + table("", lambda k, box: ["box", *named(k, box)]).partition("\n")[2], ("A", "B")),
        ("lists by name.json", {name: {"fields": list(FIELDS), "boxes": dict(zip(NAMES, map(list, PILE), strict=True))}
                                for name in "AB"}, ("A", "B")),
        ("stacks.csv", table(f"stack,box,x,y,z,{SIZES},weight", lambda k, box: [1, *named(k, box)])
         + table("2", lambda k, box: [2, *named(k, box)]).partition("\n")[2], ("stacks/1", "stacks/2")),
        ("loads.json", {"loads": [{"load_id": name, "x": 0, "y": 1000 * number, "z": 0, "length": 1200, "width": 800,
                                   "height": 900, "units": boxes_by(plain)} for number, name in enumerate("AB")]},
         ("A", "B")),
    ],
)  # fmt: skip
def test_no_list_of_boxes_is_lost_beside_another(
    name: str, content: Any, plans: tuple[str, ...], tmp_path: Path
) -> None:
    plan_set = load(tmp_path, name, content if isinstance(content, str | bytes) else json.dumps(content))
    assert tuple(plan.plan_id for plan in plan_set.plans) == plans
    for plan in plan_set.plans:
        check_pile(plan)


def test_what_is_not_read_is_noted(tmp_path: Path) -> None:
    other = [["box", *(f"{name} [cm]" for name in FIELDS[:6])], *(row[:7] for row in BOX_ROWS[1:])]
    twice = [["box", "box", *FIELDS], *([row[0], *row] for row in BOX_ROWS[1:])]
    plan_set = load(tmp_path, "load.xlsx", sheets(A=BOX_ROWS, B=other, C=twice))
    line, of_list = plan_set.conventions
    assert "load.xlsx: not read: 8 boxes in B, because its columns differ from those of the boxes read" in of_list
    assert "sheet C not read: column box occurs twice" in line
    names = ("x", "y", "z", "length", "width", "height", "kg")
    boxes = [dict(zip(names, box, strict=True)) for box in PILE[:4]]
    boxes[0]["children"] = [dict(zip(names, (0, 0, 300, *PILE[4][3:]), strict=True))]
    of_list = load(tmp_path, "inside.json", json.dumps({"boxes": boxes}), up="z").conventions[1]
    assert "1 box in boxes[].children[], because they are inside other boxes" in of_list
    hidden = openpyxl.load_workbook(io.BytesIO(sheets(A=BOX_ROWS, B=BOX_ROWS)))
    hidden["B"].sheet_state = "hidden"
    hidden.save(content := io.BytesIO())
    assert "sheet B not read: it is hidden" in notes_of(load(tmp_path, "load.xlsx", content.getvalue()))
    quantities = table(f"box,x,y,z,{SIZES},weight,qty", lambda k, box: [*named(k, box), 2 if k == 3 else 1])
    assert "qty is above 1 in some rows, but each row is read as one box" in notes_of(
        load(tmp_path, "a.csv", quantities)
    )
    of_article = table(f"sku,x,y,z,{SIZES},weight,qty", lambda k, box: ["A", *box, 8])
    assert "above 1" not in notes_of(load(tmp_path, "b.csv", of_article))
    loads = table(f"box,x,y,z,{SIZES},max_load", lambda k, box: [NAMES[k], *box[:6], "50 kg"])
    assert "no weights: 300 kg/m³" in notes_of(load(tmp_path, "c.csv", loads))


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        (table(f"box,x,y,z,{SIZES},weight", lambda k, box: [NAMES[k], box[0], 3e9 if k == 5 else box[1], *box[2:]]),
         "row 7 (f): y must be from -20000 to 20000 (millimetres), got 3000000000.0"),
        (transposed().replace("300;300;300;300;250;", "300;300;300;300;25O;"),
         'column 6 (e): height must be a number, got "25O"'),
        ("box;dimensions;location\na;400 x nan x 200;0, 0, 0\nb;400 x 300 x 200;0, 0, 200\n",
         'row 2 (a): dimensions must be three finite numbers, got "400 x nan x 200"'),
        (json.dumps({"boxes": boxes_by(lambda box: {"vertices": [[9, 9, 9], *corners(box)[1:]]})}),
         "boxes[0] (a): vertices.min[0] must be a number"),
        (printed(boxes_by(plain)).replace("12.0", "nan", 1), "line 1 (a): weight must be finite, got nan"),
        (nested("Pallet", boxes_by(plain)).replace("12.0", "", 1), "Pallet.Box[0] (a): Weight is missing"),
        ("\n".join(" ".join(map(str, [*box[3:6], *box[:3], (-1) ** (k == 3) * box[6]])) for k, box in enumerate(PILE)),
         "row 4: column 7 must be > 0, got -12"),
        (table(f"box,x,y,z,{SIZES},kg,orientation", lambda k, box: [*named(k, box), ("front", "side", "top")[k % 3]]),
         "orientation has rotations of unknown meaning (front, side, top); if sizes are those of the boxes as placed"),
        (json.dumps([*turned([0, 0, 90])[:4], *turned([0, 0, 30])[4:]]),
         "[4] (e): rotation[0] is turned by 30° out of right angles"),
        (json.dumps([*turned([0, 0, 1.5708])[:4], *turned([0, 0, 1.5])[4:]]),
         "[4] (e): rotation[0] is turned by 4.06° out of right angles"),
        (json.dumps([*turned([0, 0, 0.0])[:4], *turned([0, 0, 0.3])[4:]]),
         "[4] (e): rotation[0] is turned by 17.2° out of right angles"),
        (table(f"name,x,y,z,{SIZES},mass,yaw_rad",
               lambda k, box: [NAMES[k], *box[:3], *before_turn(k, box), box[6], 1.5708 * TURNED[k] + 0.3 * (k == 4)]),
         'row 6 (e): yaw_rad must be a multiple of 90 degrees, got "0.3"'),
        (json.dumps([*turned([0, 0, 90])[:4], *turned([0, 0, "9O"])[4:]]),
         '[4] (e): rotation[2] must be a number, got "9O"'),
        (table(f"stack,box,x,y,z,{SIZES},kg", lambda k, box: [k % 2, *named(k, box)]),
         "stack may name pallets, or stacks of one pallet; say which with --columns plan=stack or --columns plan=-"),
        (f"{table(f'box,x,y,z,{SIZES},weight', named)}".replace("e,", "Cube: 81.2 %,,,,,,,\ne,", 1),
         "row 6: is no box: Cube: 81.2 %"),
        (table(f"name,{SIZES},mass,across,along,up", lambda k, box: [NAMES[k], *box[3:], *box[:3]]),
         "has sizes of boxes, but no places (x, y, z): name their columns with --columns x=NAME,y=NAME,z=NAME, or"),
        (DOCUMENTS["data classes"].replace("z=300", "z=3OO", 1),
         'line 5 (e): position.z must be a number, got "3OO"'),
        (table(f"box,x,y,z,{SIZES},kg", named, ";").replace("e;0.0;0.0;300.0;", "e,0.0,0.0,300.0,").replace(
            "400.0;300.0;250.0;6.5", "400.0,300.0,250.0,6.5", 1), "row 6: has 1 field instead of 8: another separator"),
        (f"{report('')[:-1]}\n      i     0", "is no box: i 0; truncated?"),
        *((table(f"name,x,y,z,{SIZES},mass,{name}",
                 lambda k, box, cells=(no, yes), odd=odd: [NAMES[k], *box[:3], *before_turn(k, box), box[6],
                                                           odd if k == 4 else cells[TURNED[k]]]),
           f"row 6 (e): {name} {fault}")
          for name, no, yes, odd, fault in (("dönük", "no", "yes", "?", 'must be 0 or 1, or a word'),
                                            ("rotated", 0, 1, 2, 'must be 0 or 1, or a word'),
                                            ("rotated", "no", "yes", "", "is missing"))),
        (json.dumps(DOCUMENTS["zeros are not written"]).replace('"y": 400', '"y": 0', 1), "[0] (a): at.x is missing"),
        (json.dumps(by_columns(hole="4")), "plan pile, [4]: z is missing"),
        (json.dumps(three_js()).replace("-0.6, 0.2, -0.4, 1]", '-0.6, "O.2", -0.4, 1]', 1),
         "object.children[2]: matrix must be 16 numbers, got O.2 as number 13"),
        (json.dumps(gltf()).replace("0.7071067811865476", "null", 1),
         "nodes[0] (a): rotation must be 4 numbers, got None as number 1"),
        (json.dumps(boxes_by(lambda box: {"position": centre(box), "size": box[3:6], "mass": box[6],
                                          "orientation": {"x": 0, "y": 0, "z": 0, "w": 1}})
                    ).replace('"w": 1', '"w": 0', 1),
         "[0] (a): orientation.w must not be 0 in all four components of a quaternion"),
        (json.dumps(boxes_by(by_matrices)).replace("-1", "-7", 1),
         "[0] (a): matrix scales the box by 7, unlike the matrices of other rows"),
    ],
)  # fmt: skip
def test_a_damaged_value_is_named_with_its_place(text: str, fault: str, tmp_path: Path) -> None:
    plan_set = load(tmp_path, "pile.txt", text)
    assert not plan_set.plans
    (skipped,) = plan_set.skipped
    assert "\n" not in skipped.message
    assert fault in skipped.message


def test_xml_with_entities_is_not_read(tmp_path: Path) -> None:
    text = nested("Pallet", boxes_by(plain)).replace("<Pallet", '<!DOCTYPE a [<!ENTITY b "c">]><Pallet', 1)
    (skipped,) = load(tmp_path, "pile.xml", text).skipped
    assert "is XML" in skipped.message


# Densities.

DENSITIES = {
    "Dichte [kg/m³]": 1.0, "Raumgewicht [kg/m³]": 1.0, "density_kg_m3": 1.0, "density [g/l]": 1.0,
    "density (g/cm3)": 1000.0, "density [kg/dm^3]": 1000.0, "densityKgPerL": 1000.0, "density t/m3": 1000.0,
    "density (lb/ft³)": 0.45359237 / 0.3048**3, "density [lbs/cu ft]": 0.45359237 / 0.3048**3,
    "density pcf": 0.45359237 / 0.3048**3, "density lb/in3": 0.45359237 / 0.0254**3,
}  # fmt: skip
"""Name of a column of densities → its unit, in kg/m³."""


@pytest.mark.parametrize("name", DENSITIES)
def test_densities_are_read_in_their_unit(tmp_path: Path, name: str) -> None:
    text = table(
        f"box,x,y,z,{SIZES},{name}",
        lambda k, box: [NAMES[k], *box[:6], 1e9 * box[6] / math.prod(box[3:6]) / DENSITIES[name]],
    )
    check_pile(load(tmp_path, "a.csv", text).plans[0])


@pytest.mark.parametrize(
    ("header", "density", "message"),
    [
        ("density [lb/gal]", 1.4, "density [lb/gal]: lb/gal is no known unit of density, such as kg/m3, g/cm3"),
        ("density", 10.4, "density has densities in an unknown unit (median: 10.4); write their unit into"),
        ("density,unit", 167, "density has densities in an unknown unit (median: 167)"),
    ],
)
def test_densities_in_an_unknown_unit_are_refused(tmp_path: Path, header: str, density: float, message: str) -> None:
    """Densities in an unknown unit are refused. Such densities may be in lb/ft³ if lengths are in inches, and if they
    would be too small for kg/m³."""
    unit = ",in" if header.endswith("unit") else ""
    boxes = [f"16,12,10,{density}{unit}"] * 2 if unit else [f"400,300,200,{density}"] * 2
    places = ["0,0,0", "16,0,0" if unit else "400,0,0"]
    rows = [",".join(row) for row in zip(places, boxes, strict=True)]
    plan_set = load(tmp_path, "a.csv", "\n".join([f"x,y,z,length,width,height,{header}", *rows, ""]))
    assert not plan_set.plans
    assert message in plan_set.skipped[0].message
    (tmp_path / "items.csv").write_text("\n".join([f"length,width,height,{header}", *boxes, ""]))
    with pytest.raises(petmjx.InputError, match=re.escape(message)):
        list(read_orders(tmp_path / "items.csv"))


def test_a_place_with_the_quantity_0_is_refused(tmp_path: Path) -> None:
    """A box with a place and the quantity 0 is refused. If all quantities are 0, the column is not used."""
    text = table(f"box,x,y,z,{SIZES},weight,quantity", lambda k, box: [*named(k, box), int(k != 2)])
    (skipped,) = load(tmp_path, "a.csv", text).skipped
    assert skipped.message.endswith("row 4 (c): quantity must be ≥ 1 in a row that has a place, got 0")
    check_pile(load(tmp_path, "a.csv", text.replace(",1\n", ",0\n")).plans[0])


# Pallets among the boxes.

CUBES = ((0, 0), (400, 0), (0, 400), (400, 400))
"""(x, y) of cubes of 400 mm in one layer."""
STACKS = ((0, 144), (600, 144), (0, 344))
"""(x, z) of boxes on a pallet."""


@pytest.mark.parametrize("up", ["y", "z"])
@pytest.mark.parametrize("last", [False, True])
@pytest.mark.parametrize("name", ["EPAL", "Euro-Palette 1"])
def test_a_named_pallet_shows_the_vertical_axis(tmp_path: Path, name: str, last: bool, up: str) -> None:
    order = (0, 1, 2) if up == "z" else (0, 2, 1)
    boxes = [(f"b{k}", (400, 400, 400), (x, y, 144)) for k, (x, y) in enumerate(CUBES)]
    pallet = [(name, (1200, 800, 144), (0, 0, 0))]
    lines = [
        ",".join(map(str, [box, *(size[axis] for axis in order), *(place[axis] for axis in order)]))
        for box, size, place in ([*boxes, *pallet] if last else [*pallet, *boxes])
    ]
    (plan,) = load(tmp_path, "a.csv", "\n".join(["name,dx,dy,dz,x,y,z", *lines, ""])).plans
    np.testing.assert_allclose(plan.corner_mm, [(x, y, 0) for x, y in CUBES])
    assert plan.articles == ("b0", "b1", "b2", "b3")


@pytest.mark.parametrize("up", ["y", "z"])
def test_the_height_of_a_pallet_in_a_column_of_types_is_no_limit(tmp_path: Path, up: str) -> None:
    order = (0, 1, 2) if up == "z" else (0, 2, 1)
    rows = [("pallet", (1200, 800, 144), (0, 0, 0)), *(("box", (600, 400, 200), (x, 0, z)) for x, z in STACKS)]
    lines = [
        ",".join(map(str, [kind, *(size[axis] for axis in order), *(place[axis] for axis in order)]))
        for kind, size, place in rows
    ]
    (plan,) = load(tmp_path, "a.csv", "\n".join(["type,dx,dy,dz,x,y,z", *lines, ""])).plans
    np.testing.assert_allclose(plan.corner_mm, [(x, 0, z - 144) for x, z in STACKS])


# Poses in other forms than nested matrices.


def pose(number: int, box: list[float]) -> FloatArray:
    """(3, 4) the pose of the middle of a box of the pile."""
    turned = [[0, -1, 0], [1, 0, 0], [0, 0, 1]] if TURNED[number] else np.eye(3)
    return np.column_stack([turned, centre(box)])


def entries(rows: int, columns: int, first: int = 0) -> str:
    return ",".join(f"m{i + first}{j + first}" for i in range(rows) for j in range(columns))


def frame(number: int, box: list[float]) -> str:
    x, y, z = centre(box)
    return f"{{X {x}, Y {y}, Z {z}, A {90 * TURNED[number]}, B 0.0, C 0}}"


def with_sizes(values: Callable[[int, list[float]], Sequence[Any]]) -> Row:
    return lambda k, box: [NAMES[k], *before_turn(k, box), box[6], *values(k, box)]


BEFORE_POSES = "box,length,width,height,weight"
POSES = {
    "3×4 in columns": table(f"{BEFORE_POSES},{entries(3, 4)}", with_sizes(lambda k, box: pose(k, box).ravel())),
    "4×4 in columns, from 1": table(
        f"{BEFORE_POSES},{entries(4, 4, 1)}", with_sizes(lambda k, box: [*pose(k, box).ravel(), 0, 0, 0, 1])
    ),
    "rotation in columns": table(
        f"{BEFORE_POSES},R11,R12,R13,R21,R22,R23,R31,R32,R33,tx,ty,tz",
        with_sizes(lambda k, box: [*pose(k, box)[:, :3].ravel(), *centre(box)]),
    ),
    "text with nested lists": table(
        f"{BEFORE_POSES},transform".replace(",", ";"), with_sizes(lambda k, box: [pose(k, box).tolist()]), ";"
    ),
    "text with 12 numbers": table(
        f"{BEFORE_POSES},pose", with_sizes(lambda k, box: [" ".join(map(str, pose(k, box).ravel()))])
    ),
    "frames of KUKA": table(f"{BEFORE_POSES},frame".replace(",", ";"), with_sizes(lambda k, box: [frame(k, box)]), ";"),
}
"""Name of a form → the pile in this form."""


@pytest.mark.parametrize("name", POSES)
def test_poses_in_tables(tmp_path: Path, name: str) -> None:
    check_pile(load(tmp_path, "a.csv", POSES[name].replace("box;", "name;")).plans[0])


@pytest.mark.parametrize("by_columns", [False, True])
@pytest.mark.parametrize("last_row", [False, True])
def test_poses_as_lists_of_numbers(tmp_path: Path, by_columns: bool, last_row: bool) -> None:
    boxes = []
    for number, box in enumerate(np.array(PILE, float).tolist()):
        matrix = np.vstack([pose(number, box), [0, 0, 0, 1]]) if last_row else pose(number, box)
        listed = (matrix.T if by_columns else matrix).ravel().tolist()
        boxes.append({"id": NAMES[number], "size": before_turn(number, box), "kg": box[6], "T": listed})
    check_pile(load(tmp_path, "a.json", json.dumps(boxes)).plans[0])


def test_rotations_as_lists_of_9_numbers(tmp_path: Path) -> None:
    boxes = [
        {"size": before_turn(k, box), "kg": box[6], "R": pose(k, box)[:, :3].ravel().tolist(), "centre": centre(box)}
        for k, box in enumerate(np.array(PILE, float).tolist())
    ]
    check_pile(load(tmp_path, "a.json", json.dumps(boxes)).plans[0])


@pytest.mark.parametrize(
    ("name", "old", "new", "message"),
    [
        (
            "3×4 in columns",
            ",0.0,550.0",
            ",0.0,55O",
            "row 9 (h): m00 … m23 must be the matrix of a pose, got 55O as number 3",
        ),
        ("rotation in columns", ",-1.0", ",-7", "row 3 (b): R11 … R33 is no rotation"),
        (
            "text with 12 numbers",
            " 550.0",
            " 55O",
            'row 9 (h): pose must be the matrix of a pose, got "1.0 0.0 0.0 55O',
        ),
        ("frames of KUKA", "A 90", "A 9O", 'row 3 (b): frame must be the matrix of a pose, got "{X 900.0, Y 200.0, Z'),
        ("frames of KUKA", "A 90", "A 80", "row 3 (b): frame is turned by 10° out of right angles"),
    ],
)
def test_a_bad_pose_is_named(tmp_path: Path, name: str, old: str, new: str, message: str) -> None:
    text = POSES[name]
    assert old in text, text
    (skipped,) = load(tmp_path, "a.csv", text.replace(old, new, 1)).skipped
    assert message in skipped.message


def test_maps_are_refused(tmp_path: Path) -> None:
    text = json.dumps({"type": "FeatureCollection", "features": [{"type": "Feature", "geometry": None}]})
    (skipped,) = load(tmp_path, "a.json", text).skipped
    assert "is a map (GeoJSON)" in skipped.message


# JSON that says less or more than it seems to.

BOX = {"x": 0, "y": 0, "z": 0, "length": 400, "width": 300, "height": 200, "weight": 5}


def test_a_repeated_field_of_a_box_is_named(tmp_path: Path) -> None:
    boxes = [BOX, {**BOX, "x": 400, "place": {"bay": 1}}]
    text = json.dumps({"meta": {"run": 1}, "boxes": boxes})
    assert len(load(tmp_path, "a.json", text.replace('"run": 1', '"run": 1, "run": 2')).plans) == 1
    for field, repeated in (('"x": 400', "x"), ('"bay": 1', "place.bay")):
        (skipped,) = load(tmp_path, "a.json", text.replace(field, f"{field}, {field}")).skipped
        assert skipped.message.endswith(f"a.json: boxes[1]: {repeated} stands twice")


def test_lists_of_boxes_that_are_empty_are_named(tmp_path: Path) -> None:
    plan_set = load(tmp_path, "a.json", json.dumps({"pallet 1": [BOX], "pallet 2": [], "pallet 3": [BOX]}))
    assert [plan.plan_id for plan in plan_set] == ["pallet 1", "pallet 3"]
    assert "no box in pallet 2" in notes_of(plan_set)
    for other in ("errors", "unplaced"):
        plan_set = load(tmp_path, "a.json", json.dumps({other: [], "placed": [BOX]}))
        assert [plan.plan_id for plan in plan_set] == ["a"]


def test_a_date_in_place_of_a_number_is_called_so(tmp_path: Path) -> None:
    book = openpyxl.Workbook()
    for row in (list(BOX), list(BOX.values()), [datetime(2026, 11, 29), *list(BOX.values())[1:]]):
        book.active.append(row)
    book.save(tmp_path / "a.xlsx")
    (skipped,) = petmjx.load_plans(tmp_path / "a.xlsx").skipped
    assert skipped.message.endswith("row 3: x must be a number, got a date")


# Texts that programs print: comments, empty values, units, long repetitions.


@pytest.mark.parametrize(
    "text",
    [
        "[{x = 1, [" + " " * 3000 + "x",
        "[{'a': 1}, " + "a." * 100_000,
        "pos( rt(\n" + "-" * 100_000,
        "pos( rt(\n" + "a(1x1x1,weight:" * 10_000,
        "x,y,z,length,width,height\n" + ("= " * 1000 + ",0,0,400,300,200\n") * 50,
    ],
    ids=["name", "number", "name of an item", "items", "cells"],
)
def test_long_repetitions_take_little_time(text: str, tmp_path: Path) -> None:
    start = time.process_time()
    assert not load(tmp_path, "a.csv" if text.startswith("x,") else "a.txt", text).plans
    assert time.process_time() - start < 2.0


def printed_box(number: int, **fields: Any) -> dict[str, Any]:
    """The fields of one of two boxes that stand side by side."""
    return {**fields, **BOX, "x": 400 * number}


def test_empty_lines_above_printed_values_count(tmp_path: Path) -> None:
    lines = [f"Box[{', '.join(map('{}={}'.format, box, box.values()))}]" for box in map(printed_box, range(3))]
    (skipped,) = load(tmp_path, "a.txt", "\n\n" + "\n".join(lines).replace("x=400", "x=?")).skipped
    assert "line 4: x must be a number" in skipped.message


def three_printed(pattern: str, **fields: Any) -> str:
    """Three boxes side by side, each in a pattern with the names and values of its fields."""
    boxes = [printed_box(number, **fields) for number in range(3)]
    return "".join(pattern % box + "\n" for box in boxes)


VALUES = "length: %(length)s, width: %(width)s, height: %(height)s, weight: %(weight)s"
SPACED = "X:%(x)s Y:%(y)s Z:%(z)s Length:%(length)s Width:%(width)s Height:%(height)s"
EDN = "{:x %(x)s :y 0 :z 0 :length 400 :width 300 :height 200 :weight 5}"
OBJECT = "{x: %(x)s, y: %(y)s, z: %(z)s, " + VALUES + "}"


@pytest.mark.parametrize(
    "text",
    [
        "[" + three_printed(OBJECT + ", // {x: 0, y: 300}") + "// " + OBJECT % printed_box(5) + "\n]",
        "[" + three_printed(OBJECT) + "/* " + three_printed(OBJECT) + "*/]",
        "{" + three_printed(OBJECT).replace(":", "=") + "--"
        + OBJECT % BOX + "\n-- a = {1}\n--[[ " + three_printed(OBJECT) + "]]}",
        "[" + three_printed(EDN) + "#_" + EDN % printed_box(5) + "\n;; " + EDN % BOX + "\n; " + EDN % BOX + "\n]",
        "return {" + three_printed(OBJECT).replace(":", "=") + "}",
        "[" + three_printed('{:id "A" ' + EDN[1:]) + "]",
        "[" + three_printed("&{" + SPACED + " Weight:%(weight)s}") + "]",
        "[" + three_printed("{Note: " + SPACED + " Name: Tag: Weight:%(weight)s}") + "]",
        "[" + three_printed("{" + SPACED + " Note: Weight:%(weight)s Tag:}") + "]",
        "[" + three_printed("Box {\n  Note = \n  Weight = 5.0m\n  " + SPACED.replace(":", " = ")
                      .replace("s ", "s\n  ") + "\n}") + "]",
        three_printed("note= weight=%(weight)s " + SPACED.replace(":", "=") + " tag="),
        "[" + three_printed("Box { x: %(x)smm, y: 0.0m, z: 0cm, length: 0.4m, width: 30cm, height: 20cm, weight: 5 }")
        + "]",
        "[" + three_printed("Box { at:\n  { x: %(x)s, y: 0, z: 0 },\n note:\n 'a', " + VALUES + " }") + "]",
        "Array\n(\n" + "".join(
            f"[{number}] => Box Object\n(\n[note:protected] => \n[id:Box:private] => \n"
            + "".join(f"[{name}] => {value}\n" for name, value in printed_box(number).items()) + ")\n"
            for number in range(3)) + ")\n",
    ],
)  # fmt: skip
def test_comments_and_empty_values_of_printed_boxes(text: str, tmp_path: Path) -> None:
    plan_set = load(tmp_path, "a.txt", text)
    assert not plan_set.skipped
    (plan,) = plan_set.plans
    np.testing.assert_allclose(plan.corner_mm, [[0, 0, 0], [400, 0, 0], [800, 0, 0]], atol=1e-6)
    np.testing.assert_allclose(plan.size_mm, [[400, 300, 200]] * 3, atol=1e-6)
    np.testing.assert_allclose(plan.mass_kg, 5.0)


def test_pallets_behind_empty_values_of_printed_boxes(tmp_path: Path) -> None:
    boxes = [f"{{Label: Pallet:{number} {SPACED % printed_box(number)}}}" for number in (0, 1)]
    assert [plan.n_boxes for plan in load(tmp_path, "a.txt", f"[{' '.join(boxes)}]").plans] == [1, 1]
    (plan,) = load(tmp_path, "a.txt", "[" + three_printed("{id: sku:1%(x)s, " + OBJECT[1:]) + "]").plans
    assert plan.item_ids == ("sku:10", "sku:1400", "sku:1800")


@pytest.mark.parametrize(
    ("other", "fault"),
    [
        ("Box(400, 0, 0, 400, 300, 200)", "line 3, column 1 (this value is no object, unlike others in its list)"),
        ("...", "line 3, column 1 (this value is no object, unlike others in its list)"),
        ("17", "line 3, column 1 (this value is no object, unlike others in its list)"),
        ("/* {x: 1}", "line 3, column 1 (a comment has no end)"),
    ],
)
def test_other_values_among_printed_boxes_are_named(other: str, fault: str, tmp_path: Path) -> None:
    text = f"[\n{OBJECT % BOX},\n{other},\n{OBJECT % printed_box(1)}]"
    (skipped,) = load(tmp_path, "a.txt", text).skipped
    assert skipped.message.endswith(fault)
    assert load(tmp_path, "a.txt", text.replace(other, "nil")).plans[0].n_boxes == 2


def test_other_values_among_lines_of_printed_boxes_are_named(tmp_path: Path) -> None:
    text = three_printed("Box " + OBJECT) + "Box(400, 0, 0, 400, 300, 200)\n"
    (skipped,) = load(tmp_path, "a.txt", text).skipped
    assert skipped.message.endswith("line 4, column 1 (this value is no object, unlike others in its list)")


def test_decimal_numbers_of_printed_boxes(tmp_path: Path) -> None:
    fields = ", ".join(f"{name.title()} = {value}M" for name, value in BOX.items())
    for text, weight in ((f"[{{ {fields} }}]", "5M"), (f"[Box {{ {fields.replace('M', 'm')} }}]", "5m")):
        assert weight in text
        (plan,) = load(tmp_path, "a.txt", text).plans
        np.testing.assert_array_equal(plan.size_mm, [[400, 300, 200]])
    (skipped,) = load(tmp_path, "a.txt", f"[Box {{ {fields.replace('M', 'm').replace(' =', ':')} }}]").skipped
    assert "weight has the unit m" in skipped.message.lower()


def test_boxes_with_a_flag_that_says_no_are_left_out(tmp_path: Path) -> None:
    boxes = [{**BOX, "placed": "yes"}, {**BOX, "x": 400, "placed": "No"}]
    as_lists = f"columns: [{', '.join(boxes[0])}]\ndata:\n- [0, 0, 0, 400, 300, 200, 5, yes]\n"
    contents = {
        "a.yaml": f"{as_lists}- [400, 0, 0, 400, 300, 200, 5, no]\n",
        "a.json": json.dumps(boxes),
        "a.csv": "\n".join(",".join(map(str, row)) for row in (boxes[0], *(box.values() for box in boxes))),
    }
    for name, content in contents.items():
        plan_set = load(tmp_path, name, content)
        assert [plan.n_boxes for plan in plan_set] == [1], name
        assert "1 box is not placed, and left out" in notes_of(plan_set)
    other_words = contents["a.csv"].replace("No", "by hand")  # such a column is no flag
    assert [plan.n_boxes for plan in load(tmp_path, "a.csv", other_words)] == [2]


@pytest.mark.parametrize("title", ["Unplaced", "Unplaced items (2)", "2 boxes not placed:", "Nicht: unpacked"])
def test_only_titles_that_say_nothing_else_are_of_boxes_that_are_not_placed(tmp_path: Path, title: str) -> None:
    lines = table(",".join(FIELDS)).splitlines()
    plan_set = load(tmp_path, "a.csv", "\n".join([*lines[:5], title, *lines[5:]]))
    is_other = title.startswith("Nicht")
    assert sum(plan.n_boxes for plan in plan_set) == (8 if is_other else 4)
    assert ("4 boxes are not placed, and left out" in notes_of(plan_set)) is not is_other


@pytest.mark.parametrize(
    "line", ["scan failed,,,,,,", ",,,,,,Label print failed", "Layer 2 (remaining)", "Unplaced: none", "0 not placed"]
)
def test_boxes_below_a_remark_are_read(tmp_path: Path, line: str) -> None:
    lines = table(",".join(FIELDS)).splitlines()
    plan_set = load(tmp_path, "a.csv", "\n".join([*lines[:5], line, *lines[5:]]))
    assert sum(plan.n_boxes for plan in plan_set) == 8
    if line in ("Unplaced: none", "0 not placed"):
        assert len(plan_set.plans) == 1
        assert "row 6 is a remark, and left out" in notes_of(plan_set)


def two_pallets(names: Sequence[str], field: str, box: dict[str, Any] = BOX) -> dict[str, Any]:
    """Two pallets with two boxes each, in a list of items."""
    boxes = [{name: value for name, value in box.items() if name != "weight"} | {"x": x} for x in (0, 400)]
    return {"items": [{field: name, "boxes": boxes} for name in names]}


@pytest.mark.parametrize("field", ["name", "pallet_id", "sku"])
def test_pallets_in_a_list_of_items_are_several_plans(tmp_path: Path, field: str) -> None:
    """The boxes of articles with a word for articles lie at other places."""
    plan_set = load(tmp_path, "a.json", json.dumps(two_pallets(["pallet 1", "pallet 2"], field)))
    assert [plan.n_boxes for plan in plan_set] == [2, 2]
    articles = two_pallets(["P", "Q"], "sku")["items"]
    apart = [{**box, "x": 800} for box in articles[1]["boxes"][:1]]
    plan_set = load(tmp_path, "b.json", json.dumps({"items": [articles[0], {**articles[1], "boxes": apart}]}))
    assert [plan.n_boxes for plan in plan_set] == [3]
    pallets = [{"id": number, "items": [articles[0], {**articles[1], "boxes": apart}]} for number in (1, 2)]
    plan_set = load(tmp_path, "c.json", json.dumps({"pallets": pallets}))
    assert [(plan.plan_id, plan.n_boxes) for plan in plan_set] == [("c/1", 3), ("c/2", 3)]


def test_the_weight_of_a_pallet_is_not_that_of_its_boxes(tmp_path: Path) -> None:
    boxes = two_pallets(["A"], "name")["items"][0]["boxes"]
    deck = {"sku": "7", "weight": 25, "length": 1200, "width": 800, "height": 144}
    for content in (
        {"items": [{"name": "pallet 1", "weight": 480, "boxes": boxes}]},
        {"boxes": boxes, "item": {"name": "EUR pallet", "weight": 25}},
        {"boxes": boxes, "item": deck},
    ):
        plan_set = load(tmp_path, "a.json", json.dumps(content))
        np.testing.assert_allclose(plan_set.plans[0].mass_kg, 7.2)
        assert "no weights" in notes_of(plan_set)


def test_a_note_tells_which_object_gives_weights(tmp_path: Path) -> None:
    boxes = two_pallets(["A"], "name")["items"][0]["boxes"]
    sizes = {name: BOX[name] for name in ("length", "width", "height", "weight")}
    places = [{axis: box[axis] for axis in "xyz"} for box in boxes]
    for content, note in (
        ({"items": [{"sku": "P", "weight": 5, "boxes": boxes}]}, "weights from items[]"),
        ({"boxes": boxes, "item": {"weight": 5}}, "weights from item"),
        ({"items": [{**sizes, "places": places}]}, "weights and sizes from items[]"),
    ):
        plan_set = load(tmp_path, "a.json", json.dumps(content))
        np.testing.assert_allclose(plan_set.plans[0].mass_kg, 5)
        assert f"; {note};" in notes_of(plan_set)


def test_a_long_cell_in_the_first_row_has_no_unit() -> None:
    """The time to seek a unit grows with the square of the length of a name: these took 10 s."""
    began = time.process_time()
    for name in ("(" * 20_000, "[lb / " * 6_000):
        assert split_unit(name) == (name, "")
    assert time.process_time() - began < 2.0
    assert split_unit("length " * 20 + "[mm]") == (("length " * 20).strip(), "mm")


def test_exact_corners_are_used_before_rounded_centres(tmp_path: Path) -> None:
    """A tool writes centres in whole centimetres, so that boxes overlap."""
    boxes = [
        {
            "position": dict(zip("xyz", [x / 10, y / 10, z / 10], strict=True)),
            "center": dict(
                zip("xyz", (round(value / 10) + 0.0 for value in centre(list(map(float, box)))), strict=True)
            ),
            "dimensions": {"w": box[3] / 10, "d": box[4] / 10, "h": box[5] / 10},
            "weight": box[6],
        }
        for box in PILE
        for x, y, z in [box[:3]]
    ]
    plan_set = load(tmp_path, "pile.json", json.dumps({"bins": [{"items": boxes}]}))
    check_pile(plan_set.plans[0])
    assert "coordinates of corners" in notes_of(plan_set)


def test_corners_of_an_anchor_refer_to_the_axes_of_the_file(tmp_path: Path) -> None:
    """With y upwards, corners with the largest z are at the other side of the deck, not at the tops."""

    def row(k: int, box: tuple[float, ...]) -> list[object]:
        x, y, z, length, width, height, mass = box
        return [NAMES[k], x, z, y + width, length, height, width, mass]

    text = table("name,x,y,z,dx,dy,dz,mass", row)
    for plan in load(tmp_path, "pile.csv", text, units="mm", anchor="corner-z", up="y"):
        check_pile(plan)


def test_a_reading_tells_what_changes_because_of_an_anchor(tmp_path: Path) -> None:
    """The coordinates are those of upper corners. As lower corners, the boxes would stand on one another along y."""
    boxes = [
        *((x, 0, 300, 600, 400, 300) for x in (0, 600)),
        *((x, 400, 300, 400, 400, 300) for x in (0, 400, 800)),
        *((x, 0, 500, 400, 600, 200) for x in (0, 400, 800)),
        *((x, 600, 450, size, 200, 150) for x, size in ((0, 500), (500, 300))),
    ]
    text = "x,y,z,dx,dy,dz,mass\n" + "".join(f"{','.join(map(str, box))},6\n" for box in boxes)
    for anchor, line in ((None, ""), ("corner", "because of the anchor given: y upwards instead of z upwards")):
        (reading,) = load(tmp_path, "pile.csv", text, units="mm,kg", anchor=anchor).readings.values()
        assert reading.up == ("y" if line else "z")
        assert [note for note in reading.notes if note.startswith("because")] == ([line] if line else [])


@pytest.mark.parametrize("unit_of_boxes", ["", " cm"])
def test_a_container_with_units_tells_nothing_about_numbers_without_units(tmp_path: Path, unit_of_boxes: str) -> None:
    def length(value: int) -> Any:
        return f"{value}{unit_of_boxes}" if unit_of_boxes else value

    boxes = [
        {
            "position": {"x": length(40 * (k % 3)), "y": length(40 * (k // 3 % 2)), "z": length(30 * (k // 6))},
            "length": length(40),
            "width": length(40),
            "height": length(30),
            "weight": 6,
        }
        for k in range(12)
    ]
    text = json.dumps({"pallet": {"length": "120 cm", "width": "80 cm", "height": "150 cm"}, "boxes": boxes})
    (plan,) = load(tmp_path, "pallet.json", text)
    assert (plan.size_mm == [400, 400, 300]).all()
    assert (plan.mass_kg == 6).all()


def test_rows_of_numbers_of_several_plans_are_all_read(tmp_path: Path) -> None:
    rows = [[400 * (k % 3), 300 * (k // 3 % 2), 200 * (k // 6), 400, 300, 200] for k in range(12)]
    some = {"P7": rows, "P8": rows[:6]}
    for value in (some, {name: {"boxes": boxes} for name, boxes in some.items()}):
        assert [(plan.plan_id, plan.n_boxes) for plan in load(tmp_path, "rows.json", json.dumps(value))] == [
            ("P7", 12),
            ("P8", 6),
        ]
    plans = load(tmp_path, "rows.json", json.dumps({"order-a": rows, "order-b": rows[:6]}))
    (reading,) = plans.readings.values()
    assert "not read: 6 boxes in order-b[], because only the list with the most boxes is read" in reading.notes


def test_numbers_that_name_plans_are_kept_as_texts(tmp_path: Path) -> None:
    boxes = [dict(zip(FIELDS, [400 * (k % 2), 300 * (k // 2), 0, 400, 300, 200, 5], strict=True)) for k in range(4)]
    for value, names in (
        ({"7": boxes}, ["7"]),
        ({"7": boxes, "0012": boxes}, ["7", "0012"]),
        ({"plan": 7, "boxes": boxes}, ["7"]),
        ({"order_id": 4711, "boxes": boxes}, ["4711"]),
        ([{"id": 7, "boxes": boxes}, {"id": 9, "boxes": boxes}], ["7", "9"]),
        ([{"plan": 7.0, **box} for box in boxes], ["7"]),
        ([{"pallet": 7, **box} for box in boxes], ["load/7"]),
        ([{"pallet": 1, **box} for box in boxes], ["load"]),
        ({"1": boxes, "2": boxes}, ["load/1", "load/2"]),
        ({"²": boxes, "3": boxes}, ["²", "3"]),
        ({"palete": boxes}, ["load"]),
        ({"paleta 17": boxes}, ["paleta 17"]),
        ({"palete": [boxes, boxes]}, ["load/1", "load/2"]),
        ([{"pallet": "EUR", **box} for box in boxes], ["load"]),
        ({"Paletten": [{"Palettennummer": f"X{k}", "Kartons": boxes} for k in (1, 2)]}, ["X1", "X2"]),
    ):
        plans = load(tmp_path, "load.json", json.dumps(value), units="mm,kg", up="z")
        assert [plan.plan_id for plan in plans] == names


def test_x3d_scenes_have_y_upwards_and_their_rotations_are_refused(tmp_path: Path) -> None:
    def scene(rotation: str) -> str:
        shapes = [
            f'<Transform translation="{x / 1000} {(z + height / 2) / 1000} {y / 1000}"{rotation * TURNED[number]}>'
            f'<Shape><Box size="{length / 1000} {height / 1000} {width / 1000}"/></Shape></Transform>'
            for number, (x, y, z, length, width, height, _) in enumerate(PILE[:4])
        ]
        return f"<X3D><Scene>{''.join(shapes)}</Scene></X3D>"

    (plan,) = load(tmp_path, "scene.x3d", scene("")).plans
    assert plan.size_mm.tolist() == [[600, 400, 300]] * 4
    (skipped,) = load(tmp_path, "scene.x3d", scene(' rotation="0 1 0 1.5708"')).skipped
    assert "rotation" in skipped.message


def test_coordinates_are_not_read_in_a_unit_in_which_no_carrier_is_large_enough(tmp_path: Path) -> None:
    """Heights in centimetres, all other lengths in millimetres: in centimetres, no boxes would overlap."""
    rows = [[number, *box[:2], box[2] / 10, *box[3:]] for number, box in enumerate(PILE)]
    text = f"name,x,y,z,{SIZES},kg\n" + "".join(",".join(map(str, row)) + "\n" for row in rows)
    assert not load(tmp_path, "load.csv", text).plans


def test_sizes_are_not_read_in_a_unit_without_a_name(tmp_path: Path) -> None:
    """With a wrong anchor, sizes of a tenth would not overlap."""
    boxes = [(600 * (k % 2), 400 * (k // 2 % 2), 300 * (k // 4 + 1)) for k in range(8)]
    text = "x,y,z,dx,dy,dz,mass\n" + "".join(f"{x},{y},{z},600,400,300,9\n" for x, y, z in boxes)
    for anchor in ("corner", "corner-x", "base-centre", "far-corner"):
        for plan in load(tmp_path, "pile.csv", text, anchor=anchor):
            assert sorted(plan.size_mm[0].tolist()) in ([300, 400, 600], [3000, 4000, 6000])


def test_a_box_beyond_the_edge_of_the_others_is_refused(tmp_path: Path) -> None:
    boxes = [(400 * (k % 3), 300 * (k // 3 % 2), 200 * (k // 6)) for k in range(12)]
    boxes[7] = (400, -300, 200)
    text = "x,y,z,dx,dy,dz,mass\n" + "".join(f"{x},{y},{z},400,300,200,6\n" for x, y, z in boxes)
    (skipped,) = load(tmp_path, "block.csv", text, units="mm").skipped
    assert skipped.message.endswith("row 9: y is beyond the edge of the other boxes, got -300")
    beside = [(x, y, z) for x, y, z in boxes if y >= 0]
    text = "x,y,z,dx,dy,dz,mass\n" + "".join(f"{x},{y},{z},400,300,200,6\n" for x, y, z in [*beside, (0, -300, 0)])
    assert len(load(tmp_path, "beside.csv", text, units="mm").plans) == 1


def test_plans_of_a_file_begin_at_the_same_height(tmp_path: Path) -> None:
    """Each plan has boxes of one height, so that centres of tops look like centres above a higher deck."""
    rows = [
        (plan, 400 * (k % 3) - 400, 300 * (k // 3) - 300, height)
        for plan, height in (("A", 280), ("B", 130))
        for k in range(9)
    ]
    text = "pallet,x,y,z,length,width,height,mass\n"
    text += "".join(f"{plan},{x},{y},{height},400,300,{height},6\n" for plan, x, y, height in rows)
    for plan in load(tmp_path, "tops.csv", text, units="mm"):
        assert plan.corner_mm[:, 2].tolist() == [0] * 9


def test_a_container_in_centimetres_holds_boxes_in_centimetres(tmp_path: Path) -> None:
    def in_cm(*values: float) -> dict[str, dict[str, object]]:
        return {name: {"value": value, "unit": "cm"} for name, value in zip("abc", values, strict=True)}

    def named(names: str, *values: float) -> dict[str, object]:
        return dict(zip(names.split(), in_cm(*values).values(), strict=True))

    boxes = [
        {"position": named("x y z", 40 * (k % 3), 40 * (k // 3 % 2), 30 * (k // 6)),
         "dimensions": named("length width height", 40, 40, 30), "name": f"b{k}"}
        for k in range(12)
    ]  # fmt: skip
    deck = {"id": "p", "inner_dimensions": named("length width height", 120, 80, 150), "placements": boxes}
    (reading,) = load(tmp_path, "pile.json", json.dumps({"containers": [deck]})).readings.values()
    assert (reading.up, reading.evidence.n_outside) == ("z", 0)


def test_a_list_under_the_name_of_a_plan_gives_its_id() -> None:
    boxes = [{"x": 400 * k, "y": 0, "z": 0, "length": 400, "width": 300, "height": 200, "weight": 3} for k in range(3)]
    assert [plan.plan_id for plan in petmjx.load_plans({"P7": boxes})] == ["P7"]


def test_weights_that_are_small_whole_numbers_are_no_rotations(tmp_path: Path) -> None:
    boxes = [(400, 300, 200, 400 * (k % 3), 300 * (k // 3 % 2), 200 * (k // 6), 3) for k in range(12)]
    np.save(tmp_path / "boxes.npy", np.array(boxes, float))
    (plan,) = petmjx.load_plans(tmp_path / "boxes.npy", units="mm,kg")
    assert plan.mass_kg.tolist() == [3] * 12


@pytest.mark.parametrize(
    "footer",
    [
        "End of report. 0 cases could not be loaded.",
        "*** end of report ***",
        "End of report",
        "Signature: ____ Date: __",
    ],
)
def test_sentences_in_printed_reports_are_no_boxes(tmp_path: Path, footer: str) -> None:
    title = "Pallet: PAL-{}  (8 cases, volume utilisation 61.2 %)"
    text = "\n".join(f"{title.format(k)}\n\n{in_pages().split(chr(10), 3)[3].partition(chr(12))[0]}" for k in (1, 2))
    first, second = load(tmp_path, "report.txt", f"{text}\n{footer}\n").plans
    assert [plan.plan_id for plan in (first, second)] == [title.format(k).replace("  ", " ") for k in (1, 2)]
    assert first.n_boxes == second.n_boxes == 5
    line = load(tmp_path, "cut.txt", f"{text}{in_pages().splitlines()[-3][:30]}\n{footer}\n").skipped[0].message
    assert "is missing" in line


def test_columns_chosen_for_sizes_hold_no_places(tmp_path: Path) -> None:
    boxes = [{"translation": box[:3], "bounds": box[3:6], "kg": box[6]} for box in PILE]
    columns = {f"{axis} size": f"bounds[{number}]" for number, axis in enumerate("xyz")}
    (plan,) = load(tmp_path, "bounds.json", json.dumps(boxes), columns=columns).plans
    check_pile(plan)


@pytest.mark.parametrize("end", ["son", "ende", "fin", "koniec"])
def test_ends_along_axes_are_far_corners_in_a_framed_table(tmp_path: Path, end: str) -> None:
    frame = f"+{'-' * 60}+"
    names = ["Boy mm", "En mm", "Yükseklik mm", *(f"{axis} {end} mm" for axis in "XYZ"), "Gewicht hg"]
    lines = [frame, f"| {' | '.join(names)} |", frame]
    for x, y, z, length, width, height, kg in PILE:
        cells = (length, width, height, x + length, y + width, z + height, 10 * kg)
        lines.append(f"| {' | '.join(map(str, cells))} |")
    (plan,) = load(tmp_path, "far.txt", "\n".join([*lines, frame])).plans
    check_pile(plan)


def test_heights_that_begin_at_one_box_are_asked(tmp_path: Path) -> None:
    """Unnamed far corners: with corners, the load would begin at the height of one box."""
    rows = [(400, 300, 230, 400 + 500 * (k // 4), 300, 230 * (k % 4 + 1)) for k in range(8)]
    text = "length;width;height;x zz;y zz;z zz\n" + "".join(";".join(map(str, row)) + "\n" for row in rows)
    plan_set = load(tmp_path, "tops.csv", text, units="mm")
    lows = {plan.corner_mm[:, 2].min() for plan in plan_set.plans}
    assert lows == {0} or "can be read in two ways" in plan_set.skipped[0].message
    assert "begin" not in "".join(reading.line() for reading in plan_set.readings.values())


def test_guessed_rotations_with_which_no_reading_is_plausible_are_named(tmp_path: Path) -> None:
    rows = [(400, 300, 200, 400 * k, 0, 0, "AB"[k % 2]) for k in range(6)]
    text = "length;width;height;x;y;z;code\n" + "".join(";".join(map(str, row)) + "\n" for row in rows)
    (skipped,) = load(tmp_path, "codes.csv", text, sizes="item").skipped
    assert "--columns rotation=NAME" in skipped.message


def test_a_row_of_single_dashes_is_a_box_without_values(tmp_path: Path) -> None:
    boxes = [f"| 400 | 300 | 200 | {400 * k} | 0 | 0 |" for k in range(3)]
    lines = ["| length mm | width mm | height mm | x mm | y mm | z mm |", "|---|---|---|---|---|---|", *boxes]
    assert load(tmp_path, "dashes.md", "\n".join([*lines, "| -- | -- |"])).plans[0].n_boxes == 3
    (skipped,) = load(tmp_path, "missing.md", "\n".join([*lines, "| - | - | - | - | - | - |"])).skipped
    assert 'length mm must be a number, got "-"' in skipped.message
