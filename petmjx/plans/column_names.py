"""Column names in other tools' files (``ColumnMeaning``): words of several languages, units, axes and anchors.

A name may be the header of a sheet ("Länge [mm]", "Pos. X", "Gewicht (kg)"), or the path of a value in JSON
("position.x", "stackable.dx", "WHD[0]"). Words in English, German, French, Spanish, Italian and Polish are known, with
and without accents, and so are the letters that usually stand for sizes (L, B, H). In further European
languages and in Turkish, the words for sizes and weights are known.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Final, Literal

from petmjx.common.units import LENGTHS_MM, MASSES_KG
from petmjx.plans.input_conventions import Limits

Kind = Literal[
    "size", "sizes", "position", "positions", "low", "high", "first", "second", "corners", "quaternion", "euler",
    "weight", "total weight", "density", "volume", "rotation", "quantity", "layers", "per layer", "plan", "sequence",
    "number", "article", "item_id", "group", "row_kind", "strength",
]  # fmt: skip
"""Meaning of a column. ``sizes`` and ``positions`` are three numbers in one cell. ``low`` and ``high`` are coordinates
of the corners with the smallest and the largest x, y and z, and ``corners`` are both corners in one cell. ``first`` and
``second`` are coordinates with the numbers 1 and 2 ("x1", "x2"), before it is known which corners they describe.
``sequence`` is a packing order. ``number`` is a running number, which may be a packing order. ``euler`` is an angle
about one axis. Only tables of items have ``total weight`` and ``per layer`` (``item_columns.ITEM_ROLES``)."""

PLACE_KINDS: Final = frozenset(("position", "positions", "low", "corners"))
SIZE_KINDS: Final = frozenset(("size", "sizes", "high", "corners"))
"""Kinds of columns that give the places of boxes, and their sizes. The corners with the largest coordinates (``high``)
give sizes together with the places."""

OWN_COLUMNS: Final = ("length_mm", "width_mm", "height_mm", "weight_kg")
"""petmjx's own names for columns of the sizes and the weight of items. The names contain the units."""

LENGTH_UNITS: Final = {
    "mm": 1.0, "millimeter": 1.0, "millimeters": 1.0, "millimetre": 1.0, "millimetres": 1.0, "milimetry": 1.0,
    "millimetri": 1.0, "milimetros": 1.0,
    "cm": 10.0, "centimeter": 10.0, "centimeters": 10.0, "centimetre": 10.0, "centimetres": 10.0, "zentimeter": 10.0,
    "dm": 100.0,
    "m": 1000.0, "meter": 1000.0, "meters": 1000.0, "metre": 1000.0, "metres": 1000.0, "metri": 1000.0,
    "metros": 1000.0,
    "in": 25.4, "inch": 25.4, "inches": 25.4, "zoll": 25.4, "pouces": 25.4, "pulgadas": 25.4, "pollici": 25.4,
    "cale": 25.4, "ft": 304.8, "feet": 304.8, "foot": 304.8,
    "mmt": 1.0, "cmt": 10.0, "dmt": 100.0, "mtr": 1000.0, "inh": 25.4, "fot": 304.8,
    "um": 0.001, "tick": 1 / 16000, "ticks": 1 / 16000,
}  # fmt: skip
"""Name of a unit of length → millimetres. A tick is the unit of packvium's files, 1/16000 mm. Codes such as MMT come
from UN/ECE Recommendation 20, which EDI uses."""
MASS_UNITS: Final = {
    "kg": 1.0, "kgs": 1.0, "kilogram": 1.0, "kilograms": 1.0, "kilo": 1.0, "kilos": 1.0, "kilogramm": 1.0,
    "g": 0.001, "gr": 0.001, "gram": 0.001, "grams": 0.001, "gramm": 0.001, "grammes": 0.001, "gramos": 0.001,
    "lb": 0.45359237, "lbs": 0.45359237, "pound": 0.45359237, "pounds": 0.45359237, "pfund": 0.5,
    "kgm": 1.0, "grm": 0.001, "lbr": 0.45359237, "tne": 1000.0,
    "oz": 0.028349523125, "t": 1000.0, "tonne": 1000.0, "tonnes": 1000.0, "hg": 0.1, "dag": 0.01, "dkg": 0.01,
}  # fmt: skip
"""Name of a unit of mass → kilograms."""
_INCH_M3: Final = 0.0254**3
_VOLUMES_M3: Final = {
    **dict.fromkeys(("m3", "cbm", "cum", "cubicmeter", "cubicmetre"), 1.0),
    **dict.fromkeys(("dm3", "l", "lt", "ltr", "liter", "litre"), 1e-3),
    **dict.fromkeys(("cm3", "ccm", "cc", "ml"), 1e-6),
    **dict.fromkeys(("ft3", "cuft", "cft", "cubicfoot", "cubicfeet"), 1728 * _INCH_M3),
    **dict.fromkeys(("in3", "cuin", "cubicinch"), _INCH_M3),
}
"""Name of a unit of volume → cubic metres."""
DENSITY_UNITS: Final = {
    "pcf": MASS_UNITS["lb"] / _VOLUMES_M3["ft3"],
    **{f"{mass}/{volume}": kg / m3 for mass, kg in MASS_UNITS.items() for volume, m3 in _VOLUMES_M3.items()},
}
"""Name of a unit of density → kg/m³."""
_DENSITY_LETTERS: Final = {unit.replace("/", ""): unit for unit in DENSITY_UNITS}
UNIT_WORDS: Final = {unit: words for unit, (_, words) in {**LENGTHS_MM, **MASSES_KG}.items()}
"""Name of a unit → the unit as messages call it."""


def word_set(text: str) -> frozenset[str]:
    """The words of a text."""
    return frozenset(text.split())


_SIZES: Final = {
    axis: word_set(words)
    for axis, words in {
        "length": "length len lgth lng lengths lange laenge longueur long longitud largo lunghezza lungh lung dlugosc "
        "dlug dl comprimento lengte lengde uzunluk laeng delka laengde langd pituus hosszusag lungime duljina",
        "width": "width wid wdth wth widths wide breite breit br largeur larg ancho anchura anch larghezza largh "
        "szerokosc szer largura breedte genislik sirka bredde bredd leveys szelesseg latime sirina",
        "height": "height hgt hght heights high hoehe hohe ho hauteur haut alto altura altezza alt wysokosc wys hoogte "
        "yukseklik vyska hojde hoyde hojd korkeus magassag inaltime visina",
        "depth": "depth depths deep tiefe profondeur prof profundidad fondo profondita glebokosc gleb diepte derinlik",
    }.items()
}
ALL_SIZE_WORDS: Final = frozenset().union(*_SIZES.values()) | word_set("l w b h d t x y z lg boy en ht")
"""Words and letters for sizes and axes."""
_X, _Y, _Z = ("x", "y", "z")
_AXES: Final = {_X: 0, _Y: 1, _Z: 2}
_AXIS_WORDS: Final = {
    "abscisse": _X, "abscissa": _X, "ascissa": _X, "abscisa": _X, "abszisse": _X, "odcieta": _X,
    "ordonnee": _Y, "ordinate": _Y, "ordinata": _Y, "ordenada": _Y, "rzedna": _Y,
    "cote": _Z, "kote": _Z, "quota": _Z, "cota": _Z, "applicate": _Z,
}  # fmt: skip
"""Words for the axes x, y and z that do not contain these letters."""
_POSITION: Final = word_set(
    "pos position positions posn coord coords coordinate coordinates koordinate koordinaten loc location "
    "placement place posizione posicion pozycja poz coordonnee coordonnees coordenada coordenadas coordinata "
    "wspolrzedna wspolrzedne ubicacion emplacement origin start point punkt anchor offset translation xyz flb "
    "flbcoordinates ecke corner coin esquina angolo rog left"
)
_ENDS: Final = word_set("max maximum end extremity extremities extremite")
"""Words for the corner of a box with the largest x, y and z. In "endCoordinates.width", too, the value is a coordinate
of this corner, not a size."""
_LOW: Final = word_set(
    "min minimum low lower start begin from von flb front minimal anfang debut inicio inizio poczatek zacatek baslangic"
)
_HIGH: Final = (
    word_set(
        "max maximum high upper end to bis rrt far maximal top ende fin fine fim koniec konec son bitis slut loppu"
    )
    | _ENDS
)
CENTRE_WORDS: Final = word_set(
    "center centre centers centres centroid mid middle midpoint mitte mittelpunkt zentrum schwerpunkt milieu centro "
    "centroide srodek com"
)
BASE_WORDS: Final = word_set("base bottom unten boden basis bas fondo podstawa")
_PLACED: Final = word_set(
    "placed rotated packed oriented final actual effective turned platziert gepackt gedreht place tourne girado"
)
_ORIENTED: Final = word_set("orient oriented")
"""Words that stand beside the letter of a size, and say that the size is that of the box as placed: "orient_L"."""
_DIMENSIONS: Final = word_set(
    "dimension dimensions dims dim size sizes masse abmessung abmessungen abmasse groesse grosse extent extents "
    "dimensiones dimensioni dimensioni wymiary wymiar taille misure medidas shape lxwxh lxbxh lwh lbh whd wdh dwh hwd "
    "wxhxd wxdxh lxlxh bxhxt dimensionen"
)
HALF_WORDS: Final = word_set("half halfsize halfextents halfextent halb halbe halber halbes demi semi mezza mezzo")
"""Words for half sizes."""
_BOUNDS: Final = word_set("bbox aabb bounds")
CONTAINER_WORDS: Final = word_set(
    "container containers bin bins pallet pallets palette paletten paleta palet pale palety palete paletes "
    "bancale bancali pall palle pallar lava truck carrier contenedor conteneur contenitore kontener ladungstrager "
    "ladetrager trailer vehicle lkw camion"
)
"""Words for pallets and other containers."""
PALLET_WORDS: Final = word_set(
    "pallet pallets palette paletten palet paleta pale palety palete bancale bancali pall palle pallar lava pal "
    "palno palnr palletno palletid palid lu hu su nve sscc lpn uld stop unit nosnik ladungstrager ladetrager "
    "ladeeinheit versandelement carrier container bin tote totes toteid"
)
"""Words that mean a pallet in names of columns that otherwise have no known meaning, and in types of records."""
TITLE_WORDS: Final = PALLET_WORDS | word_set(
    "order auftrag bestellung lieferung tour commande livraison pedido ordine zamowienie delivery shipment load plan "
    "stack"
)
"""Words in titles of sections that hold the boxes of one plan."""
_UNPLACED: Final = word_set(
    "unfit unfitted unpacked unplaced unassigned unloaded leftover leftovers remaining rejected failed unused "
    "notpacked notplaced"
)
"""Words in names of lists and in titles of sections whose boxes are not part of the plan."""
_WORDS: Final[dict[Kind, frozenset[str]]] = {
    "weight": word_set(
        "weight weights mass masses masse gewicht gew poids peso pesos waga masa ciezar wt wg wgt bruttogewicht kg "
        "agirlik hmotnost vaha vaegt vekt vikt paino suly greutate tezina brgew bruttogew nettogew"
    ),
    "density": word_set("density dichte densite densidad densita gestosc"),
    "volume": word_set("volume vol volumen volumes objetosc objem kubatur"),
    "rotation": word_set(
        "rotation rotated rotationtype rot rt orientation orient orientierung ausrichtung drehung gedreht rotacion "
        "rotazione rotacja orientacion orientazione orientacja tourne girado ruotato obrot angle winkel yaw "
        "turned ori theta gedraaid gekanteld rotacionado virado girato volteado otoceno obrocony gedr verdreht "
        "giro sens rotatie rotasjon rotering rotace rotacija rotacao rotasyon draaiing vridning drejning kierto "
        "forgatas elforgatas pootoceni otoceni rotire donus girada ruotata rodado rodada rotacionada virada girata "
        "volteada swapped quarterturn quarterturns"
    ),
    "quantity": word_set(
        "quantity qty quantities amount count copies menge anzahl stuck stueck stk quantite qte nombre cantidad "
        "quantita ilosc liczba pieces pcs qta uds ud unidades stuckzahl anzahlstuck pezzi piezas sztuk adet miktar"
    ),
    "layers": word_set("layers layer tiers lagen lage schichten couches couche capas strati warstwy"),
    "sequence": word_set(
        "sequence seq step steps order packingorder packorder loadorder loadingorder placementorder rank reihenfolge "
        "schritt packreihenfolge ordre etape secuencia sequenza passo kolejnosc krok paso packfolge stapelfolge "
        "ladefolge volgorde raekkefolge rekkefolge ordning jarjestys sequencia orden ordine ordem"
    ),
    "number": word_set(
        "nr no num number numero nummer index idx lfd lfdnr lp n pos position row zeile ligne fila riga wiersz"
    ),
    "article": word_set(
        "article articles artikel artikelnr artikelnummer sku skus product products produkt produkte produit articulo "
        "articolo artykul producto prodotto material materialnr ref reference referencia riferimento type typ tipo "
        "cargo goods kind name names bezeichnung description beschreibung partno article_id codice codigo code kod "
        "item gtin urun vare varenr varenummer tuote zbozi polozka artikl towar artigo"
    ),
    "item_id": word_set(
        "id ids uid uuid itemid boxid caseid box boxes case cases carton cartons karton packstuck packstueck colis "
        "caja cajas bulto bultos collo colli kolli kollo scatola cartone boite caisse kartonu paczka paczki pudelko "
        "pudelka caixa doos ctn parcel package kiste barcode label ean sscc lpn handle partno partnumber "
        "piece serial serialno serialnumber doosnr"
    ),
    "group": word_set("group productgroup gruppe warengruppe category kategorie categorie categoria"),
    "plan": word_set("plan plans planid load stack batch solution pattern") | CONTAINER_WORDS,
    "strength": word_set("loadbear strength maxload tragkraft bearing"),
}
_LETTERS: Final[tuple[tuple[tuple[str, ...], tuple[str, ...]], ...]] = (
    (("L", "l", "H"), ("length", "width", "height")),
    (("L", "l", "h"), ("length", "width", "height")),
    (("l", "w", "h"), ("length", "width", "height")),
    (("l", "b", "h"), ("length", "width", "height")),
    (("w", "h", "d"), ("width", "height", "depth")),
    (("b", "h", "t"), ("width", "height", "depth")),
    (("l", "h", "p"), ("width", "height", "depth")),
    (("l", "p", "a"), ("width", "depth", "height")),
    (("l", "w", "d"), ("length", "width", "depth")),
    (("l", "d", "h"), ("length", "depth", "height")),
    (("d", "s", "w"), ("length", "width", "height")),
    (("l", "a", "h"), ("length", "width", "height")),
)
"""Letters of three columns → their meanings: longueur, largeur, hauteur; Länge, Breite, Höhe; Breite, Höhe, Tiefe;
largeur, hauteur, profondeur; larghezza, profondità, altezza; długość, szerokość, wysokość; largo, ancho, and H. In the
first two entries, "L" and "l" have different meanings."""

_LONE: Final = {"l": "length", "w": "width", "b": "width", "h": "height", "d": "depth", "t": "depth"}
"""Letters that name a size even if no other column is named by a letter."""
_SHORT: Final = {"lg": "length", "boy": "length", "en": "width", "ht": "height"}
"""Short words that are a size if they stand alone. In other names, they mean something else: "Prix HT", "Poids en
kg"."""
_BOX: Final = word_set(
    "box item case carton ctn outer parcel package pkg karton kiste caja colis collo placed dim size"
)

_COMPOUND: Final = re.compile(
    r"^(artikel|aussen|brutt?o|nett?o|halbe?|demi|semi|box|carton|case|einzel|item|karton|kisten?|kolli|pack(?:age|stuc?k|stueck)|paket|parcel|produkt|stuc?k)"
    r"(lange|laenge|length|breite|width|hoe?he|height|tiefe|depth|longueur|largeur|hauteur|mass|gewicht|weight|vikt|vaegt|vekt|paino|nummer|nr|id)$"
)
"""A word for a box and a word for its size, weight or number, written as one word: "Artikellänge", "Kartongewicht",
"boxwidth", "Brutogewicht"."""
_TOKEN: Final = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+|'")
_UNIT_MARK: Final = re.compile(
    r"[\[(\{<]\s*([^\])}>]*?)\s*[\])}>]|/\s*([a-zµ]+)\s*$|\bin\s+([a-z]+)\s*$", re.IGNORECASE
)
_SCALE: Final = re.compile(r"(?<![a-zA-Z])(?i:scale)(?![a-zA-Z])|(?<=[a-z])Scale(?![a-z])|(?<![a-zA-Z])scale(?=[XYZ])")
"""Names of scale factors. In scenes of three.js and Unity, boxes are scaled unit cubes, so the factors are their
sizes."""
_INDEX: Final = re.compile(r"\[(\d+)\]")
_ORDER: Final = re.compile(
    r"(?<![a-z])([lwhbdtap])\s*[x×*/,;]\s*([lwhbdtap])\s*[x×*/,;]\s*([lwhbdtap])(?![a-z])", re.IGNORECASE
)
"""The order of three sizes in one cell: "Maße (LxBxH)"."""


@dataclass(frozen=True, slots=True)
class ColumnMeaning:
    """Meaning of a column's name.

    Attributes:
        kind: role of the column.
        axis: axis of a size or a position; "": no axis. The axis of a size is length, width, height or depth, or x, y
            or z (``dx``, ``LX``). The axis of a position is x, y or z, or a word for a size, such as length. The axis
            of a member of a list is "0", "1" or "2".
        unit: name of the unit in ``LENGTH_UNITS``, ``MASS_UNITS`` or ``DENSITY_UNITS``; "": no unit.
        anchor: for positions, the point according to the name (``centre``, ``base-centre``, ``corner``); "": none is
            given.
        placed: whether the name implies that sizes are given for the box as placed.
        half: whether sizes are half extents.
        of_container: whether the column describes the container or the pallet, not the box.
        letter: whether the axis is given by a single letter.
        order: for three numbers in one cell, the names of their axes, such as ("length", "width", "height"); empty: no
            names.
    """

    kind: Kind
    axis: str = ""
    unit: str = ""
    anchor: str = ""
    placed: bool = False
    half: bool = False
    of_container: bool = False
    letter: bool = False
    order: tuple[str, ...] = ()


_WEIGHTS_BY_UNIT: Final = word_set(
    "kg kgs kilo kilos kilogram kilograms kilogramm gram grams gramm grammes gramos lb lbs pounds"
)
"""Units of mass that are the whole name of a column of weights."""
_NUMBER_SIGN: Final = re.compile(r"\b[nN]\s?[°º]|№")


_OTHER_SCRIPTS: Final = {
    word: english
    for english, words in {
        "length": "длина 长度 長度 长 長さ 長 길이", "width": "ширина 宽度 寬度 宽 寬 幅 너비 폭",
        "height": "высота 高度 高さ 高 높이", "depth": "глубина 深度 深さ 深 奥行き 奥行 깊이",
        "weight": "вес масса 重量 重さ 质量 質量 무게 중량", "gross": "брутто 毛重", "center": "центр 中心 중심",
        "coordinate": "координата координаты 坐标 座標 좌표", "position": "позиция положение 位置 위치",
        "pallet": "паллета паллет палета поддон 托盘 托盤 栈板 棧板 パレット 팔레트 파레트",
        "article": "артикул товар наименование 产品 產品 商品 物料 货物 貨物 品名 品番 名称 名稱 제품 상품 품명",
        "quantity": "количество 数量 數量 수량", "sequence": "порядок последовательность 顺序 順序 順番 순서",
        "number": "номер 序号 序號 编号 編號 番号 번호", "layer": "слой ярус 层 層 段 단",
        "box": "коробка короб 箱 段ボール 상자", "rotation": "поворот 旋转 旋轉 回転 회전",
        "total": "итого всего 合计 合計 总计 總計 小计 합계",
        "mm": "мм 毫米", "cm": "см 厘米 公分", "kg": "кг 千克 公斤", "m": "м 米", "g": "г 克",
    }.items()
    for word in words.split()
}  # fmt: skip
"""Words and units in other scripts → the English word."""
_IN_OTHER_SCRIPT: Final = re.compile(
    "|".join(rf"(?<!\w){word}(?!\w)" if word[0] < "\u0500" else word for word in sorted(_OTHER_SCRIPTS, key=len)[::-1]),
    re.IGNORECASE,
)
"""A word in Cyrillic is only recognised as a whole word. A word in another script is also recognised inside a longer
text, since these scripts put few spaces between words."""


_PLAIN_LETTERS: Final = str.maketrans(
    {"ł": "l", "Ł": "L", "ß": "ss", "µ": "u", "ı": "i", "æ": "ae", "ø": "o", "°": " deg "}
)
"""Letters and signs that Unicode does not decompose into a plain letter and an accent → their replacements."""


@lru_cache(maxsize=1 << 12)
def plain_text(text: str) -> str:
    """Text without accents: "Länge" → "Lange", "długość" → "dlugosc", "Maße" → "Masse". Known words in other scripts
    are translated: "длина" → "length", "x坐标" → "x coordinate"."""
    if not text.isascii():
        # The pattern ignores case. If the lower case of a matched word is not in ``_OTHER_SCRIPTS``, the word is kept.
        text = _IN_OTHER_SCRIPT.sub(lambda match: f" {_OTHER_SCRIPTS.get(match[0].lower(), match[0])} ", text).strip()
    text = _NUMBER_SIGN.sub("No ", text).translate(_PLAIN_LETTERS)
    return "".join(letter for letter in unicodedata.normalize("NFKD", text) if not unicodedata.combining(letter))


_CAMEL_UNIT: Final = re.compile(
    r"(.*(?:[a-z](?=[A-Z])|[a-z][XYZ](?=[a-z])))(Mm|Cm|Kg|MM|CM|KG|Lbs|Lb|Inches|Meters|Grams|Pounds|mm|cm)"
)
"""A unit at the end of a name, without a space or bracket before the unit: "lengthMm", "posXmm"."""


_MEMBER: Final = re.compile(r"(.+?)(\.[^.\[\]]*|\[\d+\])")
"""The name of a member of an object or of a list: "position.x", "size[0]"."""
LONGEST_NAME: Final = 256
"""Largest number of characters of a name in which a unit is sought. The time of the search grows with the square of the
length: a cell of 8,000 brackets took 1 s."""


def split_unit(name: str) -> tuple[str, str]:
    """A name without its unit, and the unit: "L [mm]" → ("L", "mm"), "length_mm" → ("length", "mm"). The unit may be
    that of an object or a list: "size_mm[0]" → ("size[0]", "mm"), "size_mm.length" → ("size.length", "mm"). The unit is
    "" if there is none, or if the name is longer than ``LONGEST_NAME``."""
    if len(name) > LONGEST_NAME:
        return name, ""
    for match in _UNIT_MARK.finditer(name):
        word = plain_text(next(filter(None, match.groups()), "")).strip(" .").lower()
        if word in LENGTH_UNITS or word in MASS_UNITS:
            return (name[: match.start()] + name[match.end() :]).strip(), word
    parts = re.split(r"[\s_.\-]+", name.strip())
    if len(parts) > 1:
        word = plain_text(parts[-1]).lower()
        units = LENGTH_UNITS.keys() | MASS_UNITS.keys()
        if (word in units and len(word) > 1) or (word in ("m", "g", "t") and parts[-1] == word):
            return name.strip()[: -len(parts[-1])].rstrip(" _.-,"), word
    camel = _CAMEL_UNIT.fullmatch(name.strip())
    if camel is not None:
        return camel[1], camel[2].lower()
    if (member := _MEMBER.fullmatch(name)) is not None:
        whole, unit = split_unit(member[1])
        return (whole + member[2], unit) if unit else (name, "")
    return name, ""


def unit_in(name: str, units: Mapping[str, float] = LENGTH_UNITS) -> str:
    """The unit in a name, if it is one of ``units``; else ""."""
    unit = split_unit(name)[1]
    return unit if unit in units else ""


_QUOTIENT: Final = re.compile(
    r"[\[(\{<]\s*([^\])}>/]+/[^\])}>]+)[\])}>]"
    rf"|\b((?:{'|'.join(MASS_UNITS)})\s*/\s*(?:cu\.?\s*)?[a-z]+[\^*]{{0,2}}3?)\s*$",
    re.IGNORECASE,
)
"""A quotient of units in brackets, or a unit of mass divided by another unit at the end of a name: "[lb / cu ft]",
"kg/m^3"."""


def _quotient(name: str) -> str:
    match = None if len(name) > LONGEST_NAME else _QUOTIENT.search(plain_text(name))
    return "" if match is None else (match[1] or match[2]).strip()


def density_unit(name: str) -> str:
    """The unit of density (one of ``DENSITY_UNITS``) in a name, such as "Dichte [kg/m³]", "density_lb_ft3" or "density
    g per cm3". The result is "" if there is none."""
    if quotient := _quotient(name):
        return _DENSITY_LETTERS.get(re.sub(r"[^a-z\d]", "", quotient.lower()), "")
    spaced = re.sub(r"(?<=[a-z\d])(?=[A-Z])", " ", plain_text(name)).lower().replace("^", "")
    words = [word for word in re.findall(r"[a-z]+3?", spaced) if word != "per"]
    ends = ("".join(words[-count:]) for count in (1, 2, 3))
    return next((_DENSITY_LETTERS[end] for end in ends if end in _DENSITY_LETTERS), "")


def unknown_density_unit(name: str) -> str:
    """The quotient of units in the name of a column of densities, if it is no unit of ``DENSITY_UNITS``; else ""."""
    return "" if density_unit(name) else _quotient(name)


def names_unplaced(name: str) -> bool:
    """Whether the name of a list, or the title of a section, says that its boxes are not part of the plan."""
    words = words_of(name.replace("_", " "))
    text = " ".join(words)
    return bool(_UNPLACED.intersection(words)) or "not placed" in text or "not packed" in text


_DECK: Final = re.compile(
    r"^\W{0,20}(?:euro?|epal|chep|gma)?[\W\d_]{0,20}(?:pallet|palette|paleta|palet|pale|bancale|europalette|europallet|epal|eur|skid)\b",
    re.IGNORECASE,
)


def names_deck(text: str) -> bool:
    """Whether a text is the name of a pallet, such as "EUR", "EPAL 1", "Euro pallet", "Palette"."""
    return _DECK.search(plain_text(text)) is not None


def is_unit(text: str) -> bool:
    """Whether a text is only a unit, as in a line of units below the headers: "mm", "[kg]"."""
    word = plain_text(text).strip(" []().").lower()
    return word in LENGTH_UNITS or word in MASS_UNITS


_SIDES: Final[dict[str, tuple[Kind, str]]] = {
    "left": ("low", "x"), "right": ("high", "x"), "front": ("low", "y"), "back": ("high", "y"), "bottom": ("low", "z"),
    "top": ("high", "z"),
}  # fmt: skip
"""Names of the sides of a box → the coordinate that a column with this name has."""
_OF_SIDE: Final = re.compile(r"^(?:(?:distance|dist|offset)[ _]+)?(?:from|to)[ _]+(?:the[ _]+)?")
"""The words before a side in names such as "From left" and "Distance from the floor"."""
_NEAR_SIDES: Final = frozenset(("left", "front", "bottom"))


def column_meanings(names: Sequence[str]) -> list[ColumnMeaning | None]:
    """The meanings of the names of a table's columns, in the same order; None: the name is unknown.

    Single letters are interpreted together: L, B and H are length, width and height, but B, H and T are width, height
    and depth.
    """
    return list(_meanings_of(tuple(names)))


def known_meanings(names: Iterable[str]) -> dict[str, ColumnMeaning]:
    """Name → meaning, for the names of columns that are known."""
    names = tuple(names)
    return {name: meaning for name, meaning in zip(names, _meanings_of(names), strict=True) if meaning is not None}


@lru_cache(maxsize=1 << 8)
def _meanings_of(names: tuple[str, ...]) -> list[ColumnMeaning | None]:
    meanings = [_meaning(name) for name in names]
    if not any(meaning is not None and meaning.kind in ("size", "sizes", "high") for meaning in meanings):
        meanings = [_meaning(_SCALE.sub(" size", name)) for name in names]
    meanings = _with_corners(meanings)
    bases = [split_unit(name.rpartition(".")[2])[0].strip(" .:") for name in names]

    def set_size(column: int, axis: str, *, placed: bool = False, half: bool = False, letter: bool = False) -> None:
        meanings[column] = ColumnMeaning("size", axis, unit_in(names[column]), placed=placed, half=half, letter=letter)

    def three_columns(pattern: re.Pattern[str]) -> dict[str, int]:
        """x, y and z → the columns whose names match a pattern with the letter of an axis; empty unless there are
        three."""
        columns = {match[1].lower(): index for index, base in enumerate(bases) if (match := pattern.fullmatch(base))}
        return columns if len(columns) == 3 else {}

    named_sides = [_OF_SIDE.sub("", base.lower()).replace("floor", "bottom") for base in bases]
    sides = {side: index for index, side in enumerate(named_sides) if side in _SIDES}
    if sides.keys() >= _NEAR_SIDES:
        for side, column in sides.items():
            meanings[column] = ColumnMeaning(*_SIDES[side], unit_in(names[column]))
    for number, column, is_placed in _numbered_sizes(names):
        set_size(column, number, placed=is_placed)
    for axis, column in three_columns(_HALF_AXIS).items():
        set_size(column, axis, half=True)
    along = three_columns(_PLACED_AXIS)
    kinds = {
        meaning.kind
        for index, meaning in enumerate(meanings)
        if meaning and index not in along.values() and not (meaning.kind == "sizes" and bases[index][-1:].isdigit())
    }
    if "position" in kinds and not kinds & {"size", "sizes", "high"}:
        for axis, column in along.items():
            set_size(column, axis, placed=True)
    for axis, column in three_columns(_LENGTH_AXIS).items():
        set_size(column, axis)
    if {"Lg", "lg"} <= set(bases):  # longueur and largeur
        set_size(bases.index("lg"), "width")
    single = {index: base for index, base in enumerate(bases) if len(base) == 1 and base.lower() not in _AXES}
    for index in [*single]:
        if single[index] == "w" and [single.get(index - back) for back in (3, 2, 1)] == ["l", "d", "h"]:
            meanings[index] = ColumnMeaning("weight")  # behind l, d and h, w is the weight, not the width
            del single[index]
            break
    for letters, axes in _LETTERS:
        is_strict = any(map(str.isupper, letters))
        columns = {base if is_strict else base.lower(): index for index, base in reversed(single.items())}
        if columns.keys() >= {*letters}:
            for letter, axis in zip(letters, axes, strict=True):
                set_size(columns[letter], axis, letter=True)
            break
    else:
        for index, base in single.items():
            if meanings[index] is None and (lone := _LONE.get(base.lower())) is not None:
                set_size(index, lone, letter=True)
    return meanings


def _with_corners(meanings: list[ColumnMeaning | None]) -> list[ColumnMeaning | None]:
    """The meanings of columns, in which coordinates with the numbers 1 and 2 ("x1", "x2") are coordinates of a corner.

    If both numbers occur, 1 stands for the low corner of a box, and 2 for the high corner. If only one of them occurs,
    it stands for the high corner, provided that other columns have coordinates without a number or with 0 ("x");
    otherwise, it stands for a point of the box.
    """
    kinds = {meaning.kind for meaning in meanings if meaning is not None}
    is_end = bool(kinds & {"low", "position", "positions"})
    ends: dict[Kind, Kind] = {"first": "low", "second": "high"}
    if not {"first", "second"} <= kinds:
        ends = dict.fromkeys(ends, "high" if is_end else "position")
    return [
        replace(meaning, kind=ends[meaning.kind]) if meaning is not None and meaning.kind in ends else meaning
        for meaning in meanings
    ]


_PLACED_AXIS: Final = re.compile(r"(?:packed|placed|rotated|oriented)[\s_.-]?([xyz])", re.IGNORECASE)
"""The name of a column with the size of a placed box along an axis, such as "PACKEDX", if other columns have the box's
place."""
_LENGTH_AXIS: Final = re.compile(r"len(?:gth)?[\s_.-]?([xyz])", re.IGNORECASE)
_HALF_AXIS: Final = re.compile(r"h([xyz])", re.IGNORECASE)
"""The name of a column with the size, or half the size, of a box along an axis, such as "len_x" and "hx", if three
columns have such names."""
_NUMBERED: Final = re.compile(r"^(.*?[A-Za-z])[\s_.-]?([0-3])$")
"""A name that ends in a number: "dim1", "DIM-2", "size_3"."""


def _numbered_sizes(names: Sequence[str]) -> Iterator[tuple[str, int, bool]]:
    """Yield (axis, column, whether it is a size as placed) for sizes that are named by numbers, "dim1", "dim2" and
    "dim3". The axes are "0", "1" and "2"."""
    stems: dict[str, dict[int, int]] = {}
    for index, name in enumerate(names):
        if (match := _NUMBERED.match(split_unit(name)[0].strip())) is not None:
            stems.setdefault(match[1], {})[int(match[2])] = index
    for stem, columns in stems.items():
        words = set(words_of(stem.rpartition(".")[2]))
        if sorted(columns) in ([0, 1, 2], [1, 2, 3]) and words & _DIMENSIONS and not words & CONTAINER_WORDS:
            for axis, number in enumerate(sorted(columns)):
                yield str(axis), columns[number], bool(words & _PLACED)


_COUNTER: Final = re.compile(
    r"^(?:#|n|nr|no|num|number|numer|numero|nummer|numbering|lfd|laufende|lp|l p|index|idx|i|k|pick|picked|picking|pos|"
    r"position|posizione|posicion|pozycja|seq|ordine|ordre|orden|ordem|sira|order|place|placed|packed|loaded|stacked|poradi|rang|rank|"
    r"count|counter|cislo|c|row|line|zeile|volgorde|volgnummer|reihe|lfdnr)(?: (?:nr|no|num|nummer|number|deg))?$"
)


def may_count(name: str) -> bool:
    """Whether a column with this name may hold running numbers of boxes, in any order: "N°", "Lfd. Nr.", "#",
    "Pick"."""
    return bool(_COUNTER.match(" ".join(re.findall(r"[a-z]+|#", plain_text(name.rpartition("[")[0] or name).lower()))))


_CONTENT: Final = re.compile(
    r"(?:/|\b(?:per|pro|je|par|por|na|w|a)[\s_])\s*(?:box|bx|case|cs|carton|ctn|cart|karton|kart|kar|kartonie|kiste|gebinde|"
    r"caja|caixa|colis|collo|cartone|scatola|opak\w*|pack|packung|vpe|ve)\.?\s*$|^inner\b"
)
"""Names of columns with the number of pieces in a box: "Uds/caja", "Stück pro Karton", "units_per_case"."""


def is_content(name: str) -> bool:
    """Whether a column with this name has the number of pieces in each box, and not the number of boxes."""
    return bool(_CONTENT.search(plain_text(name).lower().replace("_", " ").strip()))


def words_of(name: str) -> list[str]:
    """The words of a name, without accents and in lower case: "posX [mm]" → pos, x; "stackable.dx" → stackable, dx."""
    text = plain_text(name)
    text = re.sub(r"(?<=[a-z])(?=[XYZ](?![a-z]))", " ", text)
    words: list[str] = []
    for match in _TOKEN.finditer(text):
        word = match[0].lower()
        compound = _COMPOUND.match(word)
        words += [word] if compound is None else compound.groups()
    return words


@lru_cache(maxsize=1 << 14)
def _meaning(name: str) -> ColumnMeaning | None:
    base, unit = split_unit(name)
    length_unit = unit if unit in LENGTH_UNITS else ""
    indices = _INDEX.findall(base)
    index = indices[-1] if indices and base.endswith("]") else ""
    written = _ORDER.search(base)
    if written is not None:
        return ColumnMeaning("sizes", unit=length_unit, order=_letters_order("".join(written.groups())))
    words = words_of(_INDEX.sub(" ", base))
    if not words:
        return None
    if {_X, _Y, _Z} <= set(words) and not index:  # three coordinates in one cell: "Position (x, y, z)"
        return ColumnMeaning("positions", unit=length_unit, anchor=_anchor_of(set(words)))
    # without "ß", German "Maße" (sizes) and "Masse" (mass) would be the same word
    of_sharp = "ß" in name
    tail = words_of(_INDEX.sub(" ", base.rpartition(".")[2])) or words
    path = words[: -len(tail)] if len(words) > len(tail) else []
    contained = bool(CONTAINER_WORDS.intersection(tail[:-1])) and tail[-1] not in CONTAINER_WORDS
    meaning = _geometry(tail, path, index, of_sharp)
    if meaning is not None:
        if meaning.kind in ("size", "sizes") and CONTAINER_WORDS.intersection(path) and not _BOX.intersection(path):
            contained = True  # "pallet.length"
        return replace(meaning, unit=length_unit, of_container=contained)
    if len(words) == 1 and words[0] in _WEIGHTS_BY_UNIT:
        return ColumnMeaning("weight", unit=words[0])
    kind = _kind_of(tail, path)
    by_unit = kind in (None, "weight") and _quotient(name) and density_unit(name)  # "Raumgewicht [kg/m³]"
    if kind == "density" or by_unit:
        return ColumnMeaning("density", unit=density_unit(name))
    if kind is None or (kind == "quantity" and is_content(name)) or (kind == "article" and _SHAPES.intersection(path)):
        return None
    if kind == "weight" or (kind in ("article", "item_id") and unit in MASS_UNITS and len(unit) > 1):  # "item.kg"
        return ColumnMeaning("weight", unit=unit if unit in MASS_UNITS else "", of_container=contained)
    return ColumnMeaning(kind, unit=unit, axis=index, of_container=contained and kind in ("quantity", "volume"))


_SHAPES: Final = word_set("primitive primitives shape shapes geometry geometries geom geoms collision collisions")
"""Words for objects whose type or name is that of a shape, not of an article."""
_ANGLE_UNITS: Final = word_set("deg degree degrees grad rad radian radians")
_SIZE_ON_AXIS: Final = re.compile(
    r"(?:[dlsw]|len|dim|size|extent|ext|box|siz)([xyz])|([xyz])(?:len|length|dim|size|extent|width|span)"
)
_PLACE_ON_AXIS: Final = re.compile(
    r"(r|rot|c|p|pos|m|ctr|cen|center|centre|mid|start|min|max|lo|hi|end|t|q|flb|loc|coor|coord|koord)([xyz])"
    r"|([xyz])(c|pos|min|max|center|centre|mid|start|end|lo|hi|loc|coor|coord|koord)"
)
"""A size or a coordinate along an axis, in one word: "dx", "xlen"; "posx", "xmin", "qx"."""
_MARKS_OF_PLACES: Final[dict[str, tuple[Kind, str]]] = {
    "q": ("quaternion", ""),
    **dict.fromkeys(("r", "rot"), ("euler", "")),
    **dict.fromkeys(("c", "m", "ctr", "cen", "center", "centre", "mid"), ("position", "centre")),
    **dict.fromkeys(("min", "lo", "start"), ("low", "")),
    **dict.fromkeys(("max", "hi", "end"), ("high", "")),
}
"""What stands beside the letter of the axis in such a word → kind of the column, and anchor. All other marks stand for
a coordinate of any point."""


def _geometry(tail: list[str], path: list[str], index: str, of_sharp: bool) -> ColumnMeaning | None:
    """The meaning of a name for a size or a coordinate; None if the name means something else."""
    words, context = set(tail), set(path)
    everything = words | context
    placed = bool(everything & (_PLACED | _ORIENTED))
    half = bool(everything & HALF_WORDS)
    tail = tail[:-1] if len(tail) > 1 and tail[-1] in _ANGLE_UNITS else tail  # "rz_deg"
    last = tail[-1]
    if last == "'" and len(tail) > 1:
        return ColumnMeaning("size", tail[-2], placed=True) if tail[-2] in _AXES else None
    size_word = next((size for size, names in _SIZES.items() if words & names), None)
    if size_word is None and len(tail) == 1:
        size_word = _SHORT.get(last)
    if size_word is None and len(tail) == 2 and tail[0] in _BOX | _ORIENTED | HALF_WORDS and last in _LONE:
        size_word = _LONE[last]
    if last == "qw" or (last == "w" and everything & {"rot", "rotation"}):
        return ColumnMeaning("quaternion", "w")
    if last in ("roll", "pitch"):
        return ColumnMeaning("euler", {"roll": "x", "pitch": "y"}[last])
    axis = next((word for word in reversed(tail) if word in _AXES), None)
    if (size := _SIZE_ON_AXIS.fullmatch(last)) is not None and not words & _POSITION:
        # a name such as "wx" is an angular velocity, not a size
        is_size, letter = last[0] != "w", size[1] or size[2]
        return ColumnMeaning("size", letter, placed=last[0] == "l" or placed, half=half) if is_size else None
    if (place := _PLACE_ON_AXIS.fullmatch(last)) is not None:
        kind, anchor = _MARKS_OF_PLACES.get(place[1] or place[4], ("position", ""))
        return ColumnMeaning(kind, place[2] or place[3], anchor=anchor)
    edge = re.fullmatch(r"([xyz])([012])", "".join(tail[-2:]))
    if edge is not None and not size_word:
        return ColumnMeaning(("low", "first", "second")[int(edge[2])], edge[1])
    if index and int(index) < 6 and (words & _BOUNDS or {"bounding", "box"} <= words):  # a list with two corners
        return ColumnMeaning("low" if int(index) < 3 else "high", str(int(index) % 3))
    if everything & {"quaternion", "quat", "quaternions", "orientation"} and (axis or last == "w" or index):
        return ColumnMeaning("quaternion", index or axis or last)
    if axis is None and len(tail) == 1 and last in _AXIS_WORDS:
        return ColumnMeaning("position", _AXIS_WORDS[last])
    may_be_mass = "masse" in words and not of_sharp and not index and axis is None
    is_dims = bool(everything & (_DIMENSIONS - {"masse"} if may_be_mass else _DIMENSIONS))
    if words & CONTAINER_WORDS and words & {"location", "nr", "no", "id"} and axis is None and not index:
        return None
    is_position = bool(everything & _POSITION) or bool(everything & CENTRE_WORDS and (axis or index))
    if size_word and is_position and not is_dims and not index and "left" not in words:
        end: Kind = "high" if everything & _ENDS else "low" if everything & {"min", "start"} else "position"
        return ColumnMeaning(end, size_word, anchor=_anchor_of(everything))
    if size_word and not (words & {"unit", "units", "total", "max", "min", "sum", "weight", "nesting", "nested"}):
        return ColumnMeaning("size", size_word, placed=placed, half=half)
    if axis is not None:
        if is_dims or words & {"d", "delta", "l", "len", "ext", "size"} or half:
            return ColumnMeaning("size", axis, placed=placed, half=half)
        if everything & {"rotation", "rot", "angle", "angles", "euler"}:
            return ColumnMeaning("euler", axis)
        if len(tail) == 1 or is_position or everything & (CENTRE_WORDS | _LOW | _HIGH | BASE_WORDS):
            if everything & _HIGH and not everything & {"left"}:
                return ColumnMeaning("high", axis)
            kind = "low" if everything & {"min", "minimum", "low", "lower"} else "position"
            return ColumnMeaning(kind, axis, anchor=_anchor_of(everything))
        return ColumnMeaning("position", axis) if len(tail) <= 2 and not words & {"bin", "grid"} else None
    if index and is_dims:
        return ColumnMeaning("size", _order_axis(everything, int(index)), placed=placed, half=half)
    if index and (is_position or tail == ["at"] or everything & (_LOW | _HIGH | CENTRE_WORDS)):
        if everything & {"max", "high", "upper", "end"}:
            return ColumnMeaning("high", index)
        kind = "low" if everything & {"min", "low", "lower", "start"} else "position"
        return ColumnMeaning(kind, index, anchor=_anchor_of(everything))
    if not index and words & (_BOUNDS | {"corners"}):
        return ColumnMeaning("corners")
    if not index and words & _DIMENSIONS and is_dims:
        return ColumnMeaning("sizes", placed=placed, half=half, order=_orders(everything))
    if not index and len(words & (_POSITION | CENTRE_WORDS)) and words & {
        "position", "translation", "coordinates", "koordinaten", "coords", "xyz", "location", "flb", "corner",
        "placement", "center", "centre", "coordonnees", "coordenadas", "coordinate", "wspolrzedne", "posizione",
        "posicion", "pozycja",
    }:  # fmt: skip
        return ColumnMeaning("positions", anchor=_anchor_of(everything))
    return None


def _order_axis(words: set[str], index: int) -> str:
    """The axis of one member of a list of sizes. In a list called WHD, the axis of the second member is "height". In a
    list without such a name, the axis of the second member is "1"."""
    order = _orders(words)
    return order[index] if index < len(order) else str(index)


def _orders(words: set[str]) -> tuple[str, ...]:
    return next((order for word in sorted(words) if (order := _letters_order(word.replace("x", "")))), ())


def _letters_order(letters: str) -> tuple[str, ...]:
    """The sizes that three letters such as "WHD" stand for; empty if they stand for none."""
    for initials, axes in _LETTERS:
        if sorted(initials) == sorted(letters):
            return tuple(axes[initials.index(letter)] for letter in letters)
        plain = [letter.lower() for letter in initials]
        if sorted(plain) == sorted(letters.lower()) and len(set(plain)) == 3:
            return tuple(axes[plain.index(letter)] for letter in letters.lower())
    return ()


def _anchor_of(words: set[str]) -> str:
    if words & CENTRE_WORDS:
        return "base-centre" if words & BASE_WORDS else "centre"
    return "corner" if words & {"corner", "ecke", "flb", "flbcoordinates", "coin", "esquina", "angolo", "rog"} else ""


_NO_WEIGHT: Final = word_set("max limit capacity total maximum tare tara dim dimensional volumetric chargeable empty")
"""Words that show that a weight is not the weight of a box with its contents."""
_UNLOADING: Final = word_set(
    "unload unloading unpack unpacking entladen entladung ausladen dechargement descarga scarico"
)
_NAMED: Final = word_set("id name nr no number nummer index label numer")
"""Words that may stand beside a word for pallets, articles or boxes in the name of a column with their names."""
_ARTICLES: Final = word_set("sku article artikel artykul articulo articolo product produkt produit gtin urun")
"""Words of which one is enough for a column of articles, whatever other words its name has."""
_CODES: Final = word_set("item cargo code codice codigo kod")
"""In the name of a column with the ids of boxes, these words may stand beside a word for boxes."""
_FIRST: Final[tuple[Kind, ...]] = (
    "density", "weight", "volume", "quantity", "layers", "rotation", "strength", "group", "sequence",
)  # fmt: skip
"""Kinds of columns that are recognised by a single word of the name, in the order in which the kinds are tried. The
order matters: "density (kg/m3)" has a word for weights, too."""


_AMOUNT: Final = re.compile(r"(?!mindest|max|rest|verpackung|inhalt|bestand|lager)[a-z]+(?:menge|anzahl|stuckzahl)$")
"""German compound words for quantities: "Liefermenge", "Kartonanzahl"."""


def _kind_of(tail: list[str], path: list[str]) -> Kind | None:
    """The kind of a column whose name contains no axis."""
    words = set(tail)
    joined = "".join(tail)
    if joined in ("m", "gross", "brutto", "net", "netto"):
        return "weight"
    if joined in ("fragile", "color", "colour", "farbe", "status", "level"):
        return None
    for kind in _FIRST:
        if words & _WORDS[kind] or joined in _WORDS[kind] or (kind == "quantity" and _AMOUNT.match(joined)):
            if kind == "sequence" and words & {"id", "no", "nr", "nummer", "number"} and "order" in words:
                return "plan"  # "order_id" names a customer's order, not a place in the packing order
            if kind == "quantity" and words & {"id", "nr", "no", "name"}:
                break
            if kind == "volume" and words & {"id", "nr", "no", "number"}:
                return "item_id"  # "Volume nº" is the number of a parcel
            if kind == "sequence" and words & _UNLOADING:
                return None  # this is the order in which boxes leave the pallet, not the packing order
            if kind == "weight" and words & _NO_WEIGHT:
                return None
            if kind == "rotation" and words & {"allowed", "possible", "keep", "updown"}:
                return None
            return kind
    if "row" in words and "type" in words:
        return "row_kind"
    if joined in ("auftrag", "auftragsnr", "commande", "pedido", "ordine", "zamowienie", "orderid", "planid"):
        return "plan"
    if words & _WORDS["plan"] and not words & {"item", "box", "case", "article", "artikel", "sku"}:
        return None if words - _WORDS["plan"] - _NAMED - {"location"} else "plan"
    if words & _ARTICLES:
        return "article"
    if joined in _WORDS["item_id"] or (words & _WORDS["item_id"] and words <= _WORDS["item_id"] | _NAMED | _CODES):
        return "item_id"
    if words <= _WORDS["number"] | {"lfd", "laufende"}:
        return "number"
    if joined in _WORDS["article"] or (words & _WORDS["article"] and words <= _WORDS["article"] | _NAMED):
        return "article"
    if "stackable" in path and "name" in words:
        return "article"
    return None


def limits_in(low: float, high: float, unit: str, units: Mapping[str, float] = LENGTH_UNITS) -> Limits:
    """Limits of a value in the unit ``unit``.

    Args:
        low, high: the limits in millimetres or kilograms.
        units: name of a unit → its length in millimetres, or its mass in kilograms.
    """
    factor = units[unit]
    return Limits(low / factor, high / factor, UNIT_WORDS.get(unit, unit))
