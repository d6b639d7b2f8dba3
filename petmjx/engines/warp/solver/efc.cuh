// Memory layout of the numbers of contacts. A contact has eight parts of four numbers. On a GPU the same parts of all
// contacts are contiguous: neighbouring threads, which have neighbouring contacts, read neighbouring parts at once. On
// a CPU all parts of one contact are contiguous.

#ifndef PETMJX_EFC_CUH
#define PETMJX_EFC_CUH

#include "block.cuh"

namespace petmjx {

const int EFC = 32;  // numbers of a contact

// The numbers of one contact.
struct Numbers {
    const float* first;  // part
#if defined(__CUDA_ARCH__)
    int apart;  // distance of one part from the next, in numbers
    static const int STRIDE = 4;  // distance of one contact from the next

    // `efc`: the array of a world with room for `most` contacts.
    inline __device__ Numbers(const float* efc, int most, int contact)
        : first(efc + STRIDE * contact), apart(STRIDE * most) {}
#else
    static const int apart = 4, STRIDE = EFC;

    inline Numbers(const float* efc, int, int contact) : first(efc + STRIDE * contact) {}
#endif

    inline CUDA_CALLABLE int place(int number) const {
#if !defined(__CUDA_ARCH__)
        // Each axis lies between its two moment arms. So the six numbers of a body's row are neighbours
        // (body_vectors.cuh).
        if (number < 27) return 9 * (number % 9 / 3) + (number < 9 ? 3 : number < 18 ? 0 : 6) + number % 3;
#endif
        return number / 4 * apart + number % 4;
    }

    inline CUDA_CALLABLE void load(float* to, int part) const { load_four(to, first + part * apart); }

    inline CUDA_CALLABLE float operator[](int number) const { return first[place(number)]; }
};

// A number of a contact, in the array of all lanes.
template <class Array>
inline CUDA_CALLABLE float& number_of(const Array& efc, int lane, int contact, int number) {
    float* of_lane = efc.data + (size_t)lane * efc.shape[1] * EFC;
    return of_lane[Numbers::STRIDE * contact + Numbers(of_lane, efc.shape[1], contact).place(number)];
}

// See kernels/efc.py.
inline CUDA_CALLABLE bool is_new(int pair, int last_pair) {
#if defined(__CUDA_ARCH__)
    return true;
#else
    return pair != last_pair;
#endif
}

}  // namespace petmjx

#endif
