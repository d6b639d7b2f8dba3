// Vectors of a body's six numbers, for the vector units of CPUs. Vectors have eight numbers; the last two are not used.

#ifndef PETMJX_BODY_VECTORS_CUH
#define PETMJX_BODY_VECTORS_CUH

#include "efc.cuh"

#if !defined(__CUDA_ARCH__)
namespace petmjx {

// Warp compiles for CPUs with Clang, which has vector types.
typedef float Six __attribute__((ext_vector_type(8)));
typedef double SixDoubles __attribute__((ext_vector_type(8)));

// A body's part of a row of J: a contact's axis, and the moment arm about it. `side`: 0 for the contact's first body, 1
// for its second.
inline Six load_six(const Numbers& contact, int side, int r) {
    Six six;
    __builtin_memcpy(&six, contact.first + 9 * r + 3 * side, sizeof six);
    return side ? six : __builtin_shufflevector(six, six, 3, 4, 5, 0, 1, 2, 6, 7);
}

inline SixDoubles as_doubles(const Six& six) { return __builtin_convertvector(six, SixDoubles); }

// The numbers of a body; zeros for a body that does not move, whose number is negative.
inline SixDoubles load_six_doubles(const double* x, int body) {
    SixDoubles six = 0.0;
    if (body >= 0) __builtin_memcpy(&six, x + 6 * body, 6 * sizeof *x);
    return six;
}

// The three rows of a body, multiplied by the curvature of a contact's cost. `s`: the curvature, a symmetric 3 × 3
// matrix, as its upper triangle row by row.
inline void bend_six(const float* s, const Six (&rows)[3], Six (&out)[3]) {
    out[0] = s[0] * rows[0] + s[1] * rows[1] + s[2] * rows[2];
    out[1] = s[1] * rows[0] + s[3] * rows[1] + s[4] * rows[2];
    out[2] = s[2] * rows[0] + s[4] * rows[1] + s[5] * rows[2];
}

}  // namespace petmjx
#endif

#endif
