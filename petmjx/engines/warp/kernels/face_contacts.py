"""Contacts of compliant boxes: the area in which the faces of two boxes press on one another. Twin of
petmjx/engines/mujoco/face_contacts.py."""

from __future__ import annotations

import warp as wp

from petmjx.world.compliance import EDGE_SHARE, FACE_COSINE, LEAST_SHARE, OUTWARD

FLAT = wp.constant(FACE_COSINE)
EDGE = wp.constant(EDGE_SHARE)
SHARE = wp.constant(LEAST_SHARE)
OUT = wp.constant(OUTWARD)
LEVEL = wp.constant(1e-9)
"""If the second moment per area is smaller than this value, m², the area counts as a line."""

STEEP = wp.constant(1e-14)
"""If the square of the slope of the depth is smaller than this value, the depth counts as the same at all points of the
area."""

MOST = wp.constant(10)
Polygon = wp.types.matrix(shape=(10, 2), dtype=wp.float32)
"""Room for the corners (x, y) of a parallelogram that has been clipped by five lines."""


@wp.func
def _face_axis(turn: wp.mat33, toward: wp.vec3) -> int:
    """The axis of the face whose normal is nearest to this direction."""
    along = wp.transpose(turn) * toward
    axis = int(0)
    if wp.abs(along[1]) > wp.abs(along[axis]):
        axis = 1
    if wp.abs(along[2]) > wp.abs(along[axis]):
        axis = 2
    return axis


@wp.func
def _column(turn: wp.mat33, axis: int) -> wp.vec3:
    return wp.vec3(turn[0, axis], turn[1, axis], turn[2, axis])


@wp.func
def _outward(turn: wp.mat33, axis: int, toward: wp.vec3) -> wp.vec3:
    """Normal of a face, out of its box."""
    out = _column(turn, axis)
    return wp.where(wp.dot(out, toward) < 0.0, -out, out)


@wp.func
def _cut(corners: Polygon, count: int, x: float, y: float, one: float) -> tuple[Polygon, int]:
    """The part of a polygon in which x·X + y·Y + one is positive: its corners, and their number."""
    left = Polygon()
    kept = int(0)
    for i in range(count):
        j = wp.where(i + 1 < count, i + 1, 0)
        here = x * corners[i, 0] + y * corners[i, 1] + one
        ahead = x * corners[j, 0] + y * corners[j, 1] + one
        if here >= 0.0 and kept < MOST:
            left[kept, 0] = corners[i, 0]
            left[kept, 1] = corners[i, 1]
            kept += 1
        if (here >= 0.0) != (ahead >= 0.0) and kept < MOST:
            part = here / (here - ahead)
            left[kept, 0] = corners[i, 0] + part * (corners[j, 0] - corners[i, 0])
            left[kept, 1] = corners[i, 1] + part * (corners[j, 1] - corners[i, 1])
            kept += 1
    return left, kept


@wp.func
def _area(corners: Polygon, count: int) -> float:
    """Area of a polygon."""
    area = float(0.0)
    for i in range(1, count - 1):
        px = corners[i, 0] - corners[0, 0]
        py = corners[i, 1] - corners[0, 1]
        qx = corners[i + 1, 0] - corners[0, 0]
        qy = corners[i + 1, 1] - corners[0, 1]
        area += 0.5 * wp.abs(px * qy - py * qx)
    return area


@wp.func
def bed_of(
    pos_a: wp.vec3,
    turn_a: wp.mat33,
    half_a: wp.vec3,
    pos_b: wp.vec3,
    turn_b: wp.mat33,
    half_b: wp.vec3,
    toward: wp.vec3,
) -> tuple[bool, wp.vec3, wp.mat44, float, float]:
    """How the faces of two boxes press on one another.

    Args:
        toward: the collider's normal, from the first box to the second.

    Returns:
        Whether the faces meet; the normal; four points, and their distances (the negative depths), with one row per
        point; the pressed area, m²; the smallest area that counts for the stiffness, m².
    """
    axis_a = _face_axis(turn_a, toward)
    axis_b = _face_axis(turn_b, toward)
    out_a = _outward(turn_a, axis_a, toward)
    out_b = _outward(turn_b, axis_b, -toward)
    normal = wp.vec3(wp.normalize(out_a - out_b))
    points = wp.mat44(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    one_a = (axis_a + 1) % 3
    two_a = (axis_a + 2) % 3
    one_b = (axis_b + 1) % 3
    two_b = (axis_b + 2) % 3
    smaller = 4.0 * wp.min(half_a[one_a] * half_a[two_a], half_b[one_b] * half_b[two_b])
    if -wp.dot(out_a, out_b) < FLAT:
        return False, toward, points, 0.0, smaller
    edge_a = half_a[one_a] * _column(turn_a, one_a)
    side_a = half_a[two_a] * _column(turn_a, two_a)
    edge_b = half_b[one_b] * _column(turn_b, one_b)
    side_b = half_b[two_b] * _column(turn_b, two_b)
    x = wp.normalize(edge_a - wp.dot(edge_a, normal) * normal)
    y = wp.cross(normal, x)
    # origin: the middle of the second box's face
    apart = pos_a - pos_b + half_a[axis_a] * out_a - half_b[axis_b] * out_b
    ax = wp.dot(apart, x)
    ay = wp.dot(apart, y)
    corners = Polygon()
    for i in range(4):
        first = wp.where(i == 0 or i == 3, 1.0, -1.0)
        second = wp.where(i < 2, 1.0, -1.0)
        corner = first * edge_a + second * side_a
        corners[i, 0] = ax + wp.dot(corner, x)
        corners[i, 1] = ay + wp.dot(corner, y)
    count = int(4)
    ex = wp.dot(edge_b, x)
    ey = wp.dot(edge_b, y)
    sx = wp.dot(side_b, x)
    sy = wp.dot(side_b, y)
    full_area = ex * sy - ey * sx
    way = wp.where(full_area < 0.0, -1.0, 1.0)
    for i in range(4):
        sign = wp.where(i % 2 == 0, way, -way)
        gx = wp.where(i < 2, sy, -ey) * sign
        gy = wp.where(i < 2, -sx, ex) * sign
        corners, count = _cut(corners, count, gx, gy, wp.abs(full_area))
    # how much the faces rise along x and y
    rise_a = -wp.vec2(wp.dot(out_a, x), wp.dot(out_a, y)) / wp.dot(out_a, normal)
    rise_b = -wp.vec2(wp.dot(out_b, x), wp.dot(out_b, y)) / wp.dot(out_b, normal)
    slope = rise_a - rise_b
    depth = wp.dot(apart, normal) - rise_a[0] * ax - rise_a[1] * ay
    full_area = EDGE * _area(corners, count)
    least = float(wp.max(full_area, SHARE * smaller))
    corners, count = _cut(corners, count, slope[0], slope[1], depth)
    # area and moments of triangles around the first corner
    area = float(0.0)
    mx = float(0.0)
    my = float(0.0)
    xx = float(0.0)
    xy = float(0.0)
    yy = float(0.0)
    for i in range(1, count - 1):
        px = corners[i, 0] - corners[0, 0]
        py = corners[i, 1] - corners[0, 1]
        qx = corners[i + 1, 0] - corners[0, 0]
        qy = corners[i + 1, 1] - corners[0, 1]
        part = 0.5 * wp.abs(px * qy - py * qx)
        area += part
        mx += part * (px + qx) / 3.0
        my += part * (py + qy) / 3.0
        xx += part * (px * px + px * qx + qx * qx) / 6.0
        yy += part * (py * py + py * qy + qy * qy) / 6.0
        xy += part * (2.0 * px * py + px * qy + qx * py + 2.0 * qx * qy) / 12.0
    if area <= 0.0:
        return True, normal, points, 0.0, least
    mx = mx / area
    my = my / area
    xx = wp.max(xx / area - mx * mx, LEVEL)
    xy = xy / area - mx * my
    yy = yy / area - my * my
    root = wp.sqrt(xx)
    lean = xy / root
    rest = wp.sqrt(wp.max(yy - lean * lean, 0.0))
    outward = wp.clamp(OUT * (full_area / area - 1.0), 0.0, 1.0)
    deepest = float(0.0)
    for i in range(count):
        deepest = wp.max(deepest, depth + slope[0] * corners[i, 0] + slope[1] * corners[i, 1])
    outward = outward / wp.max(wp.dot(slope, slope), STEEP)
    center = pos_b + half_b[axis_b] * out_b
    for i in range(4):
        first = wp.where(i < 2, -1.0, 1.0)
        second = wp.where(i % 2 == 0, -1.0, 1.0)
        u = corners[0, 0] + mx + first * root
        v = corners[0, 1] + my + first * lean + second * rest
        deep = wp.max(depth + slope[0] * u + slope[1] * v, 0.0)
        further = outward * wp.max(deepest - deep, 0.0)
        u += further * slope[0]
        v += further * slope[1]
        height = rise_b[0] * u + rise_b[1] * v + 0.5 * deep
        point = center + u * x + v * y + height * normal
        points[i, 0] = point[0]
        points[i, 1] = point[1]
        points[i, 2] = point[2]
        points[i, 3] = -deep
    return True, normal, points, area, least
