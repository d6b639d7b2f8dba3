// The arithmetic of fill.cpp: halves of hulls, 3 × 3 matrices, loads. Matrices are stored row by row.

namespace petmjx {

inline CUDA_CALLABLE double min_of(double a, double b) { return a < b ? a : b; }
inline CUDA_CALLABLE double max_of(double a, double b) { return a > b ? a : b; }

// One half of the convex hull of (count, 2) points, read from `from` in steps of `step`: its corners, in `chain`, and
// their number without the last, which begins the other half.
inline CUDA_CALLABLE int half_hull(const double* from, int count, int step, double least_turn, double* chain) {
    int length = 0;
    for (int i = 0; i < count; ++i) {
        const double x = from[2 * i * step], y = from[2 * i * step + 1];
        while (length > 1) {
            const double *a = chain + 2 * (length - 2), *b = chain + 2 * (length - 1);
            if ((b[0] - a[0]) * (y - b[1]) - (b[1] - a[1]) * (x - b[0]) > least_turn) break;
            --length;
        }
        chain[2 * length] = x;
        chain[2 * length + 1] = y;
        ++length;
    }
    return length - 1;
}

// a⁻¹ of a 3 × 3 matrix, by Gauss and Jordan with pivots.
inline CUDA_CALLABLE void invert(const double* a, double* inverse) {
    double m[3][6];
    for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 3; ++j) {
            m[i][j] = a[3 * i + j];
            m[i][3 + j] = i == j;
        }
    for (int column = 0; column < 3; ++column) {
        int pivot = column;
        for (int i = column + 1; i < 3; ++i)
            if (fabs(m[i][column]) > fabs(m[pivot][column])) pivot = i;
        for (int j = 0; j < 6; ++j) {
            const double kept = m[column][j];
            m[column][j] = m[pivot][j];
            m[pivot][j] = kept;
        }
        const double scale = 1.0 / m[column][column];
        for (int j = 0; j < 6; ++j) m[column][j] *= scale;
        for (int i = 0; i < 3; ++i) {
            if (i == column) continue;
            const double factor = m[i][column];
            for (int j = 0; j < 6; ++j) m[i][j] -= factor * m[column][j];
        }
    }
    for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 3; ++j) inverse[3 * i + j] = m[i][3 + j];
}

// Adds a · b to a sum of 3 × 3 matrices.
inline CUDA_CALLABLE void multiply(const double* a, const double* b, double* sum) {
    for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 3; ++j)
            sum[3 * i + j] += a[3 * i] * b[j] + a[3 * i + 1] * b[3 + j] + a[3 * i + 2] * b[6 + j];
}

// Adds the passed-on part of one load to another load (kg, kg·m, kg·m).
inline CUDA_CALLABLE void load_on(const double* passed, const double* load, double* sum) {
    for (int i = 0; i < 3; ++i)
        sum[i] += passed[3 * i] * load[0] + passed[3 * i + 1] * load[1] + passed[3 * i + 2] * load[2];
}

// How far a load acts beyond an edge of a hull, times its weight: kg·m.
inline CUDA_CALLABLE double beyond(const double* plane, const double* load) {
    return plane[0] * load[0] + plane[1] * load[1] + plane[2] * load[2];
}

}  // namespace petmjx
