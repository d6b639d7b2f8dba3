"""Warp kernel that lowers boxes at the extreme points of pallets until they rest on something. Twin of
``petmjx.loop.candidate_places``."""

from __future__ import annotations

import warp as wp

from petmjx.packers.pile_balance import SHARE_SLACK, TOUCH_MM

TOUCH = wp.constant(wp.float64(TOUCH_MM))
SLACK = wp.constant(wp.float64(SHARE_SLACK))


@wp.func
def _is_before(a: wp.vec3d, b: wp.vec3d) -> bool:
    """Whether a place is lower than another place, or equally low and has a smaller x, or also an equal x and a smaller
    y."""
    if a[2] != b[2]:
        return a[2] < b[2]
    if a[0] != b[0]:
        return a[0] < b[0]
    return a[1] < b[1]


@wp.kernel(enable_backward=False, module="unique", module_options={"block_dim": 1, "fuse_fp": False})
def lower_boxes(
    pallet: wp.array(dtype=wp.int64),
    size: wp.array(dtype=wp.vec3d),
    points: wp.array2d(dtype=wp.vec2d),
    n_points: wp.array(dtype=wp.int64),
    low: wp.array2d(dtype=wp.vec3d),
    high: wp.array2d(dtype=wp.vec3d),
    n_boxes: wp.array(dtype=wp.int64),
    extent: wp.vec2d,
    max_height: wp.float64,
    least_support: wp.float64,
    gap: wp.float64,
    count: wp.array(dtype=wp.int64),
    corner: wp.array2d(dtype=wp.vec3d),
    support: wp.array2d(dtype=wp.float64),
) -> None:
    """One thread for each new box. The arguments are those of ``petmjx.loop.compiled_places.lowered_boxes``, except
    that ``size``, ``high`` (the highest corners of the boxes on the pallets) and ``extent`` include the free space. The
    last three arguments are the results: the number of places of each new box, their corners and supported shares."""
    row = wp.tid()
    on = pallet[row]
    new = size[row]
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
            first = low[on, box]
            last = high[on, box]
            if first[0] < x_far and first[1] < y_far and x_near < last[0] and y_near < last[1]:
                z = wp.max(z, last[2])
        if not (z + new[2] <= max_height + TOUCH):
            continue
        share = wp.float64(1.0)
        if z > wp.float64(0.0):
            carried = wp.float64(0.0)
            for box in range(boxes):
                first = low[on, box]
                last = high[on, box]
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
        while at > 0 and _is_before(place, corner[row, at - 1]):
            corner[row, at] = corner[row, at - 1]
            support[row, at] = support[row, at - 1]
            at -= 1
        corner[row, at] = place
        support[row, at] = share
        n_places += 1
    count[row] = wp.int64(n_places)
