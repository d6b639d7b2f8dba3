"""Warp kernels that find the extreme points of pallets, and lower boxes at these points until they rest on something.
The kernels are twins of ``petmjx.loop.extreme_points`` and ``petmjx.loop.candidate_places``."""

from __future__ import annotations

import warp as wp

from petmjx.packers.pile_balance import SHARE_SLACK, TOUCH_MM

TOUCH = wp.constant(wp.float64(TOUCH_MM))
SLACK = wp.constant(wp.float64(SHARE_SLACK))


@wp.func
def _is_before(a: wp.vec3d, b: wp.vec3d) -> bool:
    """Whether place ``a`` comes before place ``b`` if places are sorted by height, then by x, then by y."""
    if a[2] != b[2]:
        return a[2] < b[2]
    if a[0] != b[0]:
        return a[0] < b[0]
    return a[1] < b[1]


@wp.func
def _add_point(
    points: wp.array2d(dtype=wp.vec2d), on: wp.int64, count: wp.int64, x: wp.float64, y: wp.float64
) -> wp.int64:
    """Add a point to the points of a pallet, unless the pallet has it. Returns the number of points."""
    for point in range(int(count)):
        if points[on, point][0] == x and points[on, point][1] == y:
            return count
    points[on, int(count)] = wp.vec2d(x, y)
    return count + wp.int64(1)


@wp.kernel(enable_backward=False, module="unique", module_options={"block_dim": 1, "fuse_fp": False})
def add_points(
    pallet: wp.array(dtype=wp.int64),
    first_row: int,
    n_known: wp.array(dtype=wp.int64),
    corner: wp.array2d(dtype=wp.vec3d),
    size: wp.array2d(dtype=wp.vec3d),
    n_boxes: wp.array(dtype=wp.int64),
    free: wp.vec3d,
    points: wp.array2d(dtype=wp.vec2d),
    n_points: wp.array2d(dtype=wp.int64),
) -> None:
    """One thread for each pallet. The arguments are those of ``petmjx.loop.compiled_places.add_points``; ``n_points``
    has the number of points after each box. The thread of index 0 has the row ``first_row`` of ``pallet``."""
    on = pallet[first_row + wp.tid()]
    for number in range(int(n_known[on]), int(n_boxes[on])):
        near = corner[on, number]
        far = near + size[on, number] + free
        # four assignments, because with a single assignment, Warp would make four names of one variable
        south = wp.float64(0.0)
        west = wp.float64(0.0)
        west_on_top = wp.float64(0.0)
        south_on_top = wp.float64(0.0)
        for box in range(number):
            low = corner[on, box]
            high = low + size[on, box] + free
            if high[1] <= near[1] + TOUCH:
                if low[0] <= far[0] and far[0] < high[0] and low[2] <= near[2] and near[2] < high[2]:
                    south = wp.max(south, high[1])
                if low[0] <= near[0] and near[0] < high[0] and low[2] <= far[2] and far[2] < high[2]:
                    south_on_top = wp.max(south_on_top, high[1])
            if high[0] <= near[0] + TOUCH:
                if low[1] <= far[1] and far[1] < high[1] and low[2] <= near[2] and near[2] < high[2]:
                    west = wp.max(west, high[0])
                if low[1] <= near[1] and near[1] < high[1] and low[2] <= far[2] and far[2] < high[2]:
                    west_on_top = wp.max(west_on_top, high[0])
        count = n_points[on, number]
        count = _add_point(points, on, count, far[0], near[1])
        count = _add_point(points, on, count, far[0], south)
        count = _add_point(points, on, count, near[0], far[1])
        count = _add_point(points, on, count, west, far[1])
        count = _add_point(points, on, count, near[0], near[1])
        count = _add_point(points, on, count, west_on_top, near[1])
        count = _add_point(points, on, count, near[0], south_on_top)
        n_points[on, number + 1] = count


@wp.kernel(enable_backward=False, module="unique", module_options={"block_dim": 1, "fuse_fp": False})
def lower_boxes(
    pallet: wp.array(dtype=wp.int64),
    size: wp.array(dtype=wp.vec3d),
    first_row: int,
    points: wp.array2d(dtype=wp.vec2d),
    n_points: wp.array(dtype=wp.int64),
    box_corner: wp.array2d(dtype=wp.vec3d),
    box_size: wp.array2d(dtype=wp.vec3d),
    n_boxes: wp.array(dtype=wp.int64),
    free: wp.vec3d,
    extent: wp.vec2d,
    max_height: wp.float64,
    least_support: wp.float64,
    count: wp.array(dtype=wp.int64),
    corner: wp.array2d(dtype=wp.vec3d),
    support: wp.array2d(dtype=wp.float64),
) -> None:
    """One thread for each new box. The arguments are those of ``petmjx.loop.compiled_places.lowered_boxes``. The thread
    of index 0 handles the box in row ``first_row`` of ``pallet`` and ``size``, the next thread the next row, and so on.
    The last three arguments are the results: (m,) the number of places of each new box, and (p, m) the corners and the
    supported shares. Row k of these two tables has the place k of each box. Few boxes have many places, so few rows are
    written."""
    row = first_row + wp.tid()
    on = pallet[row]
    gap = free[0]
    new = size[row] + free
    boxes = int(n_boxes[on])
    n_places = int(0)
    for point in range(int(n_points[on])):
        x = points[on, point][0]
        y = points[on, point][1]
        x_end = x + new[0]
        y_end = y + new[1]
        if not (x_end <= extent[0] + TOUCH and y_end <= extent[1] + TOUCH):
            continue
        x_near, y_near = x + TOUCH, y + TOUCH
        x_far, y_far = x_end - TOUCH, y_end - TOUCH
        z = wp.float64(0.0)
        for box in range(boxes):
            first = box_corner[on, box]
            last = first + box_size[on, box] + free
            if first[0] < x_far and first[1] < y_far and x_near < last[0] and y_near < last[1]:
                z = wp.max(z, last[2])
        if not (z + new[2] <= max_height + TOUCH):
            continue
        share = wp.float64(1.0)
        if z > wp.float64(0.0):
            carried = wp.float64(0.0)
            for box in range(boxes):
                first = box_corner[on, box]
                last = first + box_size[on, box] + free
                if first[0] < x_far and first[1] < y_far and x_near < last[0] and y_near < last[1]:
                    if z - TOUCH <= last[2]:
                        side_x = wp.min(x_end, last[0]) - wp.max(x, first[0]) - gap
                        side_y = wp.min(y_end, last[1]) - wp.max(y, first[1]) - gap
                        carried += wp.max(side_x, wp.float64(0.0)) * wp.max(side_y, wp.float64(0.0))
            share = carried / ((new[0] - gap) * (new[1] - gap))
        if not (share >= least_support - SLACK):
            continue
        place = wp.vec3d(x, y, z)
        at = n_places
        while at > 0 and _is_before(place, corner[at - 1, row]):
            corner[at, row] = corner[at - 1, row]
            support[at, row] = support[at - 1, row]
            at -= 1
        corner[at, row] = place
        support[at, row] = share
        n_places += 1
    count[row] = wp.int64(n_places)
