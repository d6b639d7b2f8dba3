// Solves H·x = g by the Cholesky factorisation H = UᵀU within H's envelope. The threads of a world share this work; on
// a CPU, a world has one thread.
//
// Right-looking by panels of 16 rows: one panel at a time in kernels for few panels, else two. Each number is computed
// by the same operations in any warp, so results do not depend on how warps share the work.

#ifndef PETMJX_CHOLESKY_CUH
#define PETMJX_CHOLESKY_CUH

#include "cholesky_small.cuh"
#include "cpu_cholesky.cuh"
#include "cholesky_large.cuh"

namespace petmjx {

#if defined(__CUDA_ARCH__) || defined(PETMJX_BLOCKS_ON_CPU)  // tests run the code for blocks on a CPU, with one thread

// Shared memory of the threads of a world. MOST: panels of the largest system.
template <int MOST, bool FEW = (MOST <= PETMJX_FEW_PANELS)>
struct Factoring : PanelPairs<MOST> {};
template <int MOST>
struct Factoring<MOST, true> : SinglePanels<MOST> {};

// Forward: H = UᵀU in place and y = U⁻ᵀ·g at the same time. Then backward.
template <int MOST>
inline CUDA_CALLABLE void factor_and_solve(const System& system, Factoring<MOST>& shared, int thread, int threads) {
    forward(system, shared, thread, threads);
    solve_backward<Factoring<MOST>::SPREAD>(system, shared.solutions, thread, threads);
}

#else
template <int MOST>
using Factoring = ByThread;
#endif

}  // namespace petmjx

#endif
