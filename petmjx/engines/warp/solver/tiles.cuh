// Tiles of 16 × 16 numbers, and products of two tiles. On a GPU, a warp computes a tile; on a CPU, a thread does.
//
// Tensor cores multiply numbers of 11 bits and add in single precision, but truncate instead of rounding. So each
// number is split into an upper and a lower part, which together have 22 of its 24 bits. A product of tiles is the sum
// of three products of parts; the product of the lower parts is left out. This sum is subtracted from other numbers
// outside the tensor cores, with rounding (Ootomo and Yokota, "Recovering single precision accuracy from Tensor Cores
// while surpassing the FP32 theoretical peak performance", Int. J. High Perform. Comput. Appl. 36, 2022).

#ifndef PETMJX_TILES_CUH
#define PETMJX_TILES_CUH

#include "block.cuh"

#if defined(__CUDA_ARCH__) && __CUDA_ARCH__ >= 800
#define PETMJX_TENSOR_CORES
#endif

namespace petmjx {

const int B = 16;  // rows of a tile

const int PITCH = 24;  // distance of rows in a separate tile: four rows begin in different banks

const int TILE = B * B;

// A lane's piece of a tile: the row 2·(lane / 4) and the next row, and in them the column 4·(lane % 4) and the next
// three columns. On a CPU, the piece is the whole tile.
#if defined(__CUDA_ARCH__)
const int PIECE_ROWS = 2, PIECE_COLUMNS = 4;
#else
const int PIECE_ROWS = B, PIECE_COLUMNS = B;
#endif

struct Piece {
    float v[PIECE_ROWS][PIECE_COLUMNS];
};

inline CUDA_CALLABLE int piece_row(int lane) { return lane / 4 * 2; }
inline CUDA_CALLABLE int piece_column(int lane) { return lane % 4 * 4; }

inline CUDA_CALLABLE Piece load_piece(const float* tile, int pitch, int lane) {
    Piece piece;
    const float* from = tile + piece_row(lane) * pitch + piece_column(lane);
    #pragma unroll
    for (int i = 0; i < PIECE_ROWS; ++i) {
        #pragma unroll
        for (int j = 0; j < PIECE_COLUMNS; j += 4) load_four(piece.v[i] + j, from + i * pitch + j);
    }
    return piece;
}

inline CUDA_CALLABLE void store_piece(float* tile, int pitch, const Piece& piece, int lane) {
    float* to = tile + piece_row(lane) * pitch + piece_column(lane);
    #pragma unroll
    for (int i = 0; i < PIECE_ROWS; ++i) {
        #pragma unroll
        for (int j = 0; j < PIECE_COLUMNS; j += 4) store_four(to + i * pitch + j, piece.v[i] + j);
    }
}

inline CUDA_CALLABLE void subtract(Piece& from, const Piece& what) {
    #pragma unroll
    for (int i = 0; i < PIECE_ROWS; ++i) {
        #pragma unroll
        for (int j = 0; j < PIECE_COLUMNS; ++j) from.v[i][j] -= what.v[i][j];
    }
}

// A lane's part of one factor of a product. With tensor cores, the part has four numbers for each i: those of the rows
// 8·i + lane % 4 and 8·i + lane % 4 + 4 in the columns 2·(lane / 4) and 2·(lane / 4) + 1, row by row. Without tensor
// cores, the part is the whole tile.
struct Operand {
#ifdef PETMJX_TENSOR_CORES
    float upper[2][4], lower[2][4];
#else
    const float* tile;
    int pitch;
#endif
};

#ifdef PETMJX_TENSOR_CORES
// The upper part of a number, rounded. The lower part is the rest, which may be NaN. So a NaN stays NaN in the products
// with lower parts, although its upper part may be a number.
inline __device__ float upper_part(float x) {
    return __uint_as_float((__float_as_uint(x) + 0x1000u) & 0xffffe000u);
}
#endif

// The operand of a lane, from a tile of numbers.
inline CUDA_CALLABLE Operand load_whole(const float* tile, int pitch, int lane) {
#ifdef PETMJX_TENSOR_CORES
    Operand out;
    #pragma unroll
    for (int i = 0; i < 4; ++i) {
        const float2 x = *(const float2*)(tile + (4 * i + lane % 4) * pitch + lane / 4 * 2);
        float* upper = out.upper[i / 2] + i % 2 * 2;
        float* lower = out.lower[i / 2] + i % 2 * 2;
        upper[0] = upper_part(x.x), upper[1] = upper_part(x.y);
        lower[0] = x.x - upper[0], lower[1] = x.y - upper[1];
    }
    return out;
#else
    return {tile, pitch};
#endif
}

// Stores a tile in the order in which lanes read it as an operand: four numbers of a lane, then four of the next lane.
inline CUDA_CALLABLE void store_in_order(float* to, const Piece& piece, int lane) {
#ifdef PETMJX_TENSOR_CORES
    #pragma unroll
    for (int i = 0; i < PIECE_ROWS; ++i) {
        const int row = piece_row(lane) + i;
        #pragma unroll
        for (int j = 0; j < PIECE_COLUMNS; j += 2) {
            const int its_lane = (piece_column(lane) + j) / 2 * 4 + row % 4;
            store_two(to + row / 8 * 128 + 4 * its_lane + row / 4 % 2 * 2, piece.v[i][j], piece.v[i][j + 1]);
        }
    }
#else
    store_piece(to, B, piece, lane);
#endif
}

inline CUDA_CALLABLE Operand load_in_order(const float* from, int lane) {
#ifdef PETMJX_TENSOR_CORES
    Operand out;
    #pragma unroll
    for (int i = 0; i < 2; ++i) {
        float x[4];
        load_four(x, from + 128 * i + 4 * lane);
        #pragma unroll
        for (int k = 0; k < 4; ++k) out.upper[i][k] = upper_part(x[k]), out.lower[i][k] = x[k] - out.upper[i][k];
    }
    return out;
#else
    return {from, B};
#endif
}

#ifdef PETMJX_TENSOR_CORES
// Adds the product of eight rows of x and of y, with column j of each two columns, to a lane's four sums. The tensor
// cores ignore the bits of a factor beyond 11.
inline __device__ void multiply_add(float (&sums)[4], const float (&x)[4], const float (&y)[4], int j) {
    asm("mma.sync.aligned.m16n8k8.row.col.f32.tf32.tf32.f32 {%0,%1,%2,%3}, {%4,%5,%6,%7}, {%8,%9}, {%0,%1,%2,%3};"
        : "+f"(sums[0]), "+f"(sums[1]), "+f"(sums[2]), "+f"(sums[3])
        : "r"(__float_as_uint(x[0])), "r"(__float_as_uint(x[1])), "r"(__float_as_uint(x[2])),
          "r"(__float_as_uint(x[3])), "r"(__float_as_uint(y[j])), "r"(__float_as_uint(y[2 + j])));
}
#endif

// The products XᵀY of N tiles X with one tile Y. The N products are independent, so that no sum waits for another one.
template <int N>
inline CUDA_CALLABLE void multiply(const Operand (&x)[N], const Operand& y, int lane, Piece (&out)[N]) {
#ifdef PETMJX_TENSOR_CORES
    float large[N][2][4], small[N][2][4];
    #pragma unroll
    for (int k = 0; k < 8 * N; ++k) large[k / 8][k / 4 % 2][k % 4] = small[k / 8][k / 4 % 2][k % 4] = 0.0f;
    #pragma unroll
    for (int i = 0; i < 2; ++i) {
        #pragma unroll
        for (int k = 0; k < 2 * N; ++k) multiply_add(small[k / 2][k % 2], x[k / 2].upper[i], y.lower[i], k % 2);
        #pragma unroll
        for (int k = 0; k < 2 * N; ++k) multiply_add(large[k / 2][k % 2], x[k / 2].upper[i], y.upper[i], k % 2);
        #pragma unroll
        for (int k = 0; k < 2 * N; ++k) multiply_add(small[k / 2][k % 2], x[k / 2].lower[i], y.upper[i], k % 2);
    }
    #pragma unroll
    for (int n = 0; n < N; ++n) {
        #pragma unroll
        for (int k = 0; k < 8; ++k) out[n].v[k / 4][k % 4] = large[n][k % 2][k / 2] + small[n][k % 2][k / 2];
    }
#else
    for (int n = 0; n < N; ++n) {
        const float* one = x[n].tile + piece_row(lane);
        const float* two = y.tile + piece_column(lane);
        for (int i = 0; i < PIECE_ROWS; ++i) {
            for (int j = 0; j < PIECE_COLUMNS; ++j) out[n].v[i][j] = 0.0f;
        }
        for (int p = 0; p < B; ++p) {
            for (int i = 0; i < PIECE_ROWS; ++i) {
                for (int j = 0; j < PIECE_COLUMNS; ++j)
                    out[n].v[i][j] += one[p * x[n].pitch + i] * two[p * y.pitch + j];
            }
        }
    }
#endif
}

// The same for one tile X.
inline CUDA_CALLABLE Piece product(const Operand& x, const Operand& y, int lane) {
    const Operand one[1] = {x};
    Piece out[1];
    multiply(one, y, lane, out);
    return out[0];
}

}  // namespace petmjx

#endif
