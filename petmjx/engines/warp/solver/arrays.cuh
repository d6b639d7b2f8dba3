// How kernels find a number of an array. In all arrays here the numbers of a row are side by side, and no index counts from
// the end. Warp's own functions allow for both, and without them a kernel has 13 to 15 % fewer instructions
// (benchmarks/notebook/performance.md). What Warp checks in its debug mode is not checked here.
//
// Warp's functions of the same names are for all kinds of arrays, so C++ prefers these, which are for one kind.

#ifndef PETMJX_ARRAYS_CUH
#define PETMJX_ARRAYS_CUH

namespace wp {

template <typename T>
inline CUDA_CALLABLE T* address(const array_t<T>& array, int i) {
    return array.data + i;
}

template <typename T>
inline CUDA_CALLABLE T* address(const array_t<T>& array, int i, int j) {
    return (T*)((char*)array.data + (long long)i * array.strides[0]) + j;
}

template <typename T>
inline CUDA_CALLABLE T* address(const array_t<T>& array, int i, int j, int k) {
    return (T*)((char*)array.data + (long long)i * array.strides[0] + (long long)j * array.strides[1]) + k;
}

template <typename T>
inline CUDA_CALLABLE void array_store(const array_t<T>& array, int i, T value) {
    *address(array, i) = value;
}

template <typename T>
inline CUDA_CALLABLE void array_store(const array_t<T>& array, int i, int j, T value) {
    *address(array, i, j) = value;
}

template <typename T>
inline CUDA_CALLABLE void array_store(const array_t<T>& array, int i, int j, int k, T value) {
    *address(array, i, j, k) = value;
}

}  // namespace wp

#endif
