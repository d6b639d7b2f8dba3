// Fills a packing up, best fit after best fit: what Packing.filled does (packing_state.py), in machine code.
//
// Every number on which a decision depends is computed by the same operations, in the same order, as in
// candidate_points.py and packing_state.py, so packings are the same to the last bit. Only balances (pile_balance.py)
// may differ from Python's in their last bits. A balance may be so near to its limit that these bits would decide. Often
// this is the balance of the new box itself, whose weight acts exactly at an edge. Then the code asks Python, and
// continues with the answer. If it is the balance of a box below, the result is UNSURE, and Packing.filled packs from
// the beginning.
//
// Names in capitals that are not defined here, and the tables, are those of fill_interface.py.

namespace petmjx {

// Differences of balances that rounding may make, kg·m. Pallets have loads of some 100 kg·m.
const double ROUNDING_KG_M = 4e-10;

const double NONE = 1e300;  // cost of an entry that is not a candidate

// A candidate's box on its supports.
struct Rest {
    int under = 0;   // boxes below it, in t.under
    int planes = 0;  // edges of their hull, in t.new_planes
    double load[3];  // its own weight: kg, kg·m, kg·m
};

template <typename Tables>
struct Filling {
    const Tables& t;
    const int most_boxes = t.low.shape[0], most_shapes = t.z.shape[1];
    const int most_points = t.points.shape[0], most_planes = t.planes.shape[0];
    int boxes = t.counts.data[BOXES], points = t.counts.data[POINTS], shapes = t.counts.data[SHAPES];
    int planes = t.counts.data[PLANES], made = t.counts.data[MADE];
    bool full = false;  // there is no room for more points or planes
    // constants and options of Python
    const double highest = t.numbers.data[HIGHEST], per_overhang = t.numbers.data[PER_OVERHANG];
    const double per_distance = t.numbers.data[PER_DISTANCE];
    const double extent_x = t.numbers.data[EXTENT_X], extent_y = t.numbers.data[EXTENT_Y];
    const double max_height = t.numbers.data[MOST_HEIGHT], least_support = t.numbers.data[LEAST_SUPPORT];
    const double touch_mm = t.numbers.data[TOUCH], slack = t.numbers.data[SLACK];
    const double margin_m = t.numbers.data[MARGIN], margin_share = t.numbers.data[MARGIN_SHARE];
    const double least_turn = t.numbers.data[LEAST_TURN], decimals = t.numbers.data[DECIMALS];
    double top_mm = t.numbers.data[TOP];

    explicit CUDA_CALLABLE Filling(const Tables& tables) : t(tables) {}

    CUDA_CALLABLE double* passed(int box, int below) const {
        return t.passed.data + ((size_t)box * most_boxes + below) * 9;
    }

    // ------------------------------------------------------------------ candidates

    CUDA_CALLABLE double cost(int point, int shape) const {
        const size_t entry = (size_t)point * most_shapes + shape;
        const double z = t.z.data[entry], support = t.carried.data[entry] / t.area.data[shape];
        if (!(z + t.height.data[shape] <= max_height) || !(support >= least_support)) return NONE;
        const double* at = t.points.data + 2 * point;
        return z - t.worth.data[shape] + per_overhang * (1.0 - support) + per_distance * (at[0] + at[1]);
    }

    // Area that a shape at a point shares with a box, seen from above.
    CUDA_CALLABLE double overlap(const double* at, int shape, const double* low, const double* high) const {
        const double* base = t.base.data + 2 * shape;
        const double x = min_of(at[0] + base[0], high[0]) - max_of(at[0], low[0]);
        if (!(x > touch_mm)) return 0.0;
        const double y = min_of(at[1] + base[1], high[1]) - max_of(at[1], low[1]);
        return y > touch_mm ? x * y : 0.0;
    }

    // Lift the candidates that the newest box lies under.
    CUDA_CALLABLE void cover(const double* low, const double* high) {
        const double top = high[2];
        for (int point = 0; point < points; ++point) {
            const double* at = t.points.data + 2 * point;
            if (!(high[0] - at[0] > touch_mm) || !(high[1] - at[1] > touch_mm)) continue;
            for (int shape = 0; shape < shapes; ++shape) {
                const double area = overlap(at, shape, low, high);
                const size_t entry = (size_t)point * most_shapes + shape;
                if (!(area > 0.0) || !t.inside.data[entry]) continue;
                double& z = t.z.data[entry];
                if (top > z + touch_mm) {
                    t.carried.data[entry] = area;
                    z = top;
                } else if (top >= z - touch_mm) {
                    t.carried.data[entry] += area;
                } else {
                    continue;
                }
                t.cost.data[entry] = cost(point, shape);
            }
        }
    }

    CUDA_CALLABLE void add_point(double x, double y) {
        for (int point = 0; point < points; ++point)
            if (t.points.data[2 * point] == x && t.points.data[2 * point + 1] == y) return;
        if (points == most_points) {
            full = true;
            return;
        }
        const size_t row = (size_t)points * most_shapes;
        bool useful = false;
        for (int shape = 0; shape < shapes; ++shape) {
            const double* base = t.base.data + 2 * shape;
            const bool inside = t.stock.data[t.kind.data[shape]] > 0 && x + base[0] <= extent_x &&
                                y + base[1] <= extent_y;
            t.inside.data[row + shape] = inside;
            useful = useful || inside;
        }
        if (!useful) return;
        double* at = t.points.data + 2 * points;
        at[0] = x;
        at[1] = y;
        for (int shape = 0; shape < shapes; ++shape) {
            const size_t entry = row + shape;
            t.cost.data[entry] = NONE;
            if (!t.inside.data[entry]) continue;
            double z = 0.0, carried = 0.0;
            for (int box = 0; box < boxes; ++box) {
                const double area = overlap(at, shape, t.low.data + 3 * box, t.high.data + 3 * box);
                const double top = t.high.data[3 * box + 2];
                if (area > 0.0) z = max_of(z, top);
                t.areas.data[box] = area;
            }
            for (int box = 0; box < boxes; ++box)
                if (fabs(t.high.data[3 * box + 2] - z) <= touch_mm) carried += t.areas.data[box];
            t.z.data[entry] = z;
            t.carried.data[entry] = z > 0.0 ? carried : t.area.data[shape];
            t.cost.data[entry] = cost(points, shape);
        }
        ++points;
    }

    // Where a point that slides along −axis meets a box, or 0.
    CUDA_CALLABLE double slid(int axis, double start, double across, double level) const {
        double reached = 0.0;
        for (int box = 0; box < boxes; ++box) {
            const double *low = t.low.data + 3 * box, *high = t.high.data + 3 * box;
            if (low[1 - axis] <= across && across < high[1 - axis] && low[2] <= level && level < high[2] &&
                high[axis] <= start + touch_mm)
                reached = max_of(reached, high[axis]);
        }
        return reached;
    }

    // ------------------------------------------------------------------ balance

    // The edges of the hull of (count, 4) rectangles, moved inward, into t.new_planes. Returns how many.
    CUDA_CALLABLE int hull_planes(const double* rectangles, int count, double margin) const {
        double *corners = t.corners.data, *chain = t.chain.data;
        int found = 0;
        for (int i = 0; i < count; ++i) {
            double side[4];
            for (int j = 0; j < 4; ++j) side[j] = rint(rectangles[4 * i + j] * decimals) / decimals;
            for (int corner = 0; corner < 4; ++corner) {
                const double x = side[corner & 2 ? 2 : 0], y = side[corner & 1 ? 3 : 1];
                int place = found;  // corners are sorted by x, then by y, without repetitions
                while (place > 0 && (corners[2 * place - 2] > x ||
                                     (corners[2 * place - 2] == x && corners[2 * place - 1] > y)))
                    --place;
                if (place > 0 && corners[2 * place - 2] == x && corners[2 * place - 1] == y) continue;
                for (int k = found; k > place; --k) {
                    corners[2 * k] = corners[2 * k - 2];
                    corners[2 * k + 1] = corners[2 * k - 1];
                }
                corners[2 * place] = x;
                corners[2 * place + 1] = y;
                ++found;
            }
        }
        int ring = half_hull(corners, found, 1, least_turn, chain);
        ring += half_hull(corners + 2 * (found - 1), found, -1, least_turn, chain + 2 * ring);
        for (int i = 0; i < ring; ++i) {
            const double *a = chain + 2 * i, *b = chain + 2 * ((i + 1) % ring);
            const double length = sqrt((b[0] - a[0]) * (b[0] - a[0]) + (b[1] - a[1]) * (b[1] - a[1]));
            double* plane = t.new_planes.data + 3 * i;
            plane[1] = (b[1] - a[1]) / length;
            plane[2] = (a[0] - b[0]) / length;
            plane[0] = margin - plane[1] * a[0] - plane[2] * a[1];
        }
        return ring;
    }

    // Computes how a candidate's box loads each box below, into t.new_passed, and which boxes this load reaches, into
    // t.reached.
    CUDA_CALLABLE void pass_on(const Rest& rest, const double* rectangles) const {
        double *sum = t.new_passed.data, total[9] = {};
        for (int i = 0; i < 9 * boxes; ++i) sum[i] = 0.0;
        for (int box = 0; box < boxes; ++box) t.reached.data[box] = 0;
        const int* under = t.under.data;
        double* moments = t.moments.data;
        for (int i = 0; i < rest.under; ++i) {
            const double* r = rectangles + 4 * i;
            const double dx = r[2] - r[0], dy = r[3] - r[1], area = dx * dy;
            const double one[3] = {1.0, (r[0] + r[2]) / 2, (r[1] + r[3]) / 2};
            for (int a = 0; a < 3; ++a)
                for (int b = 0; b < 3; ++b) moments[9 * i + 3 * a + b] = one[a] * one[b];
            moments[9 * i + 4] += dx * dx / 12;
            moments[9 * i + 8] += dy * dy / 12;
            for (int j = 0; j < 9; ++j) {
                moments[9 * i + j] *= area;
                total[j] += moments[9 * i + j];
            }
        }
        double inverse[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1};
        if (rest.under > 1) invert(total, inverse);
        for (int i = 0; i < rest.under; ++i) {
            double share[9] = {};
            if (rest.under > 1)
                multiply(moments + 9 * i, inverse, share);
            else  // the only box below takes the whole load
                share[0] = share[4] = share[8] = 1.0;
            for (int box = 0; box <= under[i]; ++box) {
                const double* from = passed(under[i], box);
                if (from[0] == 0.0 && from[1] == 0.0 && from[2] == 0.0) continue;  // no part of the load
                multiply(from, share, sum + 9 * box);
                t.reached.data[box] = 1;
            }
        }
    }

    // KEEPS: the pile keeps its balance with a candidate's box. TIPS: this box or a box below tips over. UNKNOWN: the
    // balance of this box is too near to its limit. NEAR: the balance of a box below is. `own` is the answer for this
    // box alone, or UNKNOWN.
    CUDA_CALLABLE int balance(int point, int shape, int own, Rest& rest) const {
        const double *at = t.points.data + 2 * point, *size = t.own_base.data + 2 * shape;
        const double z = t.z.data[(size_t)point * most_shapes + shape], mass = t.weight.data[shape];
        const double corner[2] = {at[0] / 1000.0, at[1] / 1000.0}, base[2] = {size[0] / 1000.0, size[1] / 1000.0};
        rest = Rest();
        rest.load[0] = mass;
        for (int axis = 0; axis < 2; ++axis) rest.load[1 + axis] = mass * (corner[axis] + base[axis] / 2);
        if (z <= 0.0) return KEEPS;
        double* rectangles = t.rectangles.data;
        for (int box = 0; box < boxes; ++box) {
            if (!(fabs(t.top.data[box] - z) <= touch_mm)) continue;
            double* r = rectangles + 4 * rest.under;
            for (int axis = 0; axis < 2; ++axis) {
                r[axis] = max_of(t.low_m.data[2 * box + axis], corner[axis]);
                r[2 + axis] = min_of(t.high_m.data[2 * box + axis], corner[axis] + base[axis]);
            }
            if (r[2] - r[0] > touch_mm / 1000.0 && r[3] - r[1] > touch_mm / 1000.0) t.under.data[rest.under++] = box;
        }
        if (!rest.under) return TIPS;
        rest.planes = hull_planes(rectangles, rest.under, margin(shape));
        double most = -NONE;
        for (int i = 0; i < rest.planes; ++i) most = max_of(most, beyond(t.new_planes.data + 3 * i, rest.load));
        if (own == UNKNOWN) {
            if (fabs(most) < ROUNDING_KG_M) return UNKNOWN;
            own = most > 0.0 ? TIPS : KEEPS;
        }
        if (own == TIPS) return TIPS;
        pass_on(rest, rectangles);
        most = -NONE;
        for (int i = 0; i < planes; ++i) {
            const int owner = t.owner.data[i];
            if (!t.reached.data[owner]) continue;  // the load of this box is as before
            double after[3];
            for (int j = 0; j < 3; ++j) after[j] = t.load.data[3 * owner + j];
            load_on(t.new_passed.data + 9 * owner, rest.load, after);
            most = max_of(most, beyond(t.planes.data + 3 * i, after));
        }
        if (fabs(most - slack) < ROUNDING_KG_M) return NEAR;
        return most <= slack ? KEEPS : TIPS;
    }

    CUDA_CALLABLE double margin(int shape) const {
        const double* own = t.own_base.data + 2 * shape;
        return min_of(margin_m, margin_share * (min_of(own[0], own[1]) / 1000.0));
    }

    // ------------------------------------------------------------------ boxes

    CUDA_CALLABLE void put_on_pile(int point, int shape, const Rest& rest) {
        const double *at = t.points.data + 2 * point, *size = t.own_base.data + 2 * shape;
        for (int axis = 0; axis < 2; ++axis) {
            t.low_m.data[2 * boxes + axis] = at[axis] / 1000.0;
            t.high_m.data[2 * boxes + axis] = at[axis] / 1000.0 + size[axis] / 1000.0;
        }
        t.top.data[boxes] = t.z.data[(size_t)point * most_shapes + shape] + t.height.data[shape];
        for (int box = 0; box < boxes; ++box) {
            double* to = passed(boxes, box);
            for (int i = 0; i < 9; ++i) to[i] = rest.under ? t.new_passed.data[9 * box + i] : 0.0;
            if (rest.under && t.reached.data[box]) load_on(to, rest.load, t.load.data + 3 * box);
        }
        double* self = passed(boxes, boxes);
        for (int i = 0; i < 9; ++i) self[i] = i % 4 == 0;
        for (int i = 0; i < 3; ++i) t.load.data[3 * boxes + i] = rest.load[i];
        full = full || planes + rest.planes > most_planes;
        for (int i = 0; i < rest.planes && !full; ++i, ++planes) {
            for (int j = 0; j < 3; ++j) t.planes.data[3 * planes + j] = t.new_planes.data[3 * i + j];
            t.owner.data[planes] = boxes;
        }
    }

    CUDA_CALLABLE void put(int point, int shape, const Rest& rest) {
        put_on_pile(point, shape, rest);
        const double x = t.points.data[2 * point], y = t.points.data[2 * point + 1];
        const double z = t.z.data[(size_t)point * most_shapes + shape], top = z + t.height.data[shape];
        double *low = t.low.data + 3 * boxes, *high = t.high.data + 3 * boxes;
        low[0] = x, low[1] = y, low[2] = z;
        high[0] = x + t.base.data[2 * shape], high[1] = y + t.base.data[2 * shape + 1], high[2] = top;
        t.made_shape.data[made] = shape;
        for (int axis = 0; axis < 3; ++axis) t.made_corner.data[3 * made + axis] = low[axis];
        ++made;
        ++boxes;
        top_mm = max_of(top_mm, top);
        cover(low, high);
        const double south = slid(1, y, high[0], z), west = slid(0, x, high[1], z);
        const double west_on_top = slid(0, x, y, top), south_on_top = slid(1, y, x, top);
        add_point(high[0], y);
        add_point(high[0], south);
        add_point(x, high[1]);
        add_point(west, high[1]);
        add_point(x, y);
        add_point(west_on_top, y);
        add_point(x, south_on_top);
        if (--t.stock.data[t.kind.data[shape]]) return;
        for (int other = 0; other < shapes; ++other)
            if (t.kind.data[other] == t.kind.data[shape])
                for (int each = 0; each < points; ++each) {
                    const size_t entry = (size_t)each * most_shapes + other;
                    t.cost.data[entry] = NONE;
                    t.inside.data[entry] = 0;
                }
    }

    // The costs of all candidates. From here on costs change with each placed box.
    CUDA_CALLABLE void begin() {
        for (int point = 0; point < points; ++point)
            for (int shape = 0; shape < shapes; ++shape) {
                const size_t entry = (size_t)point * most_shapes + shape;
                t.cost.data[entry] = t.open.data[entry] ? cost(point, shape) : NONE;
            }
    }

    CUDA_CALLABLE bool find_best(int& point, int& shape) const {
        double least = NONE;
        for (int each = 0; each < points; ++each)
            for (int other = 0; other < shapes; ++other) {
                const double value = t.cost.data[(size_t)each * most_shapes + other];
                if (value < least) least = value, point = each, shape = other;
            }
        return least < NONE;
    }

    // Places boxes until one of the ends. `how` and `own` are about the first box: it is the candidate `point`,
    // `shape`, unless `how` is WITH_BEST, and `own` is the answer whether it keeps its own balance. If the end is ASKS,
    // `point` and `shape` are set to the candidate about which Python must decide.
    CUDA_CALLABLE int fill(int& point, int& shape, int how, int own) {
        if (how != WITH_ANSWER) begin();
        bool chosen = how != WITH_BEST;
        while (chosen || top_mm <= highest) {
            if (full) return UNSURE;
            if (!chosen && !find_best(point, shape)) return FILLED;
            Rest rest;
            const int kept = balance(point, shape, chosen ? own : UNKNOWN, rest);
            if (kept == NEAR || (kept == TIPS && how == WITH_FIRST && !made)) return UNSURE;
            if (kept == UNKNOWN) {
                t.counts.data[UNDER] = rest.under;
                for (int i = 0; i < 3; ++i) t.own_load.data[i] = rest.load[i];
                return ASKS;
            }
            if (kept == TIPS)
                t.cost.data[(size_t)point * most_shapes + shape] = NONE;
            else
                put(point, shape, rest);
            chosen = false;
        }
        return HIGHER;
    }
};

template <typename Tables>
inline CUDA_CALLABLE void fill(const Tables& tables) {
    Filling<Tables> filling(tables);
    int* counts = tables.counts.data;
    counts[END] = filling.fill(counts[POINT], counts[SHAPE], counts[HOW], counts[OWN]);
    counts[BOXES] = filling.boxes;
    counts[POINTS] = filling.points;
    counts[PLANES] = filling.planes;
    counts[MADE] = filling.made;
    tables.numbers.data[TOP] = filling.top_mm;
}

}  // namespace petmjx
