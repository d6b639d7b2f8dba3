// Access to array elements in kernels. In all arrays here the numbers of a row are contiguous, and no index counts from
// the end. Warp's own functions also allow for strides and negative indices. Without strides and negative indices, a
// kernel has 13 to 15 % fewer instructions (benchmarks/notebook/performance.md). The checks of Warp's debug mode are
// missing here.
//
// Warp's functions of the same names are templates for all kinds of arrays. C++ prefers the functions of this file,
// since each of them is for one kind of array.

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
