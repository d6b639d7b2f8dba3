// The linear system of a step, H·x = g, in H's envelope.
//
// H's upper triangle is stored in whole tiles of 16 × 16. Panel J's columns begin at row 16·top[J]; the factor is zero
// above it. Panels are stored one after another, each row by row. So an envelope takes no more room than it needs, and
// a small one fits into shared memory.

#ifndef PETMJX_LINEAR_SYSTEM_CUH
#define PETMJX_LINEAR_SYSTEM_CUH

#include "tiles.cuh"

namespace petmjx {

// The columns of a body: six neighbouring columns, in one panel or in two.
struct Columns {
    float* one;
    float* two;
    int first;  // first of the panel's columns

    inline CUDA_CALLABLE float& entry(int row, int i) const {
        const int column = first + i;
        return (column < B ? one : two)[row * B + column % B];
    }
};

struct System {
    // A, strip and rhs begin at multiples of 16 bytes.
    float* A;         // H, then its factor in its place: U's tiles, on the diagonal their inverses
    float* strip;     // room for the tiles of a panel's row, or two panels' rows
    int panels;
    const int* top;   // (panels,) first panel that each panel's columns reach up to
    const int* base;  // (panels + 1,) where each panel's numbers begin
    float* rhs;       // (16·panels,) g, then x in its place; NaN or infinite if H is not positive definite

    // Address of entry (0, 16·J), if it were stored. The entry of row r and column 16·J + c is at r·16 + c.
    inline CUDA_CALLABLE float* panel(int J) const { return A + base[J] - top[J] * B * B; }

    inline CUDA_CALLABLE float* tile(int K, int J) const { return panel(J) + K * B * B; }

    inline CUDA_CALLABLE float& entry(int row, int column) const {
        return panel(column / B)[row * B + column % B];
    }

    inline CUDA_CALLABLE Columns columns(int body) const {
        const int J = 6 * body / B, first = 6 * body % B;
        float* one = panel(J);
        return {one, first + 6 > B ? panel(J + 1) : one, first};
    }
};

}  // namespace petmjx

#endif
