// One world as the constraint solver sees it.

#ifndef PETMJX_WORLD_CUH
#define PETMJX_WORLD_CUH

#include "efc.cuh"

namespace petmjx {

// Views of one world's arrays, which world_arrays.py describes. Bodies here are the free bodies.
struct World {
    int ncon, nfree, nv;
    const float* efc;           // the numbers of contacts (efc.cuh)
    int nconmax;                // contacts for which there is room
    const int* body;            // (contact, 2) bodies; negative: does not move
    const int* body_conadr;     // (body + 1,) where each body's contacts begin
    const int* body_contact;    // 2·contact + side, body after body
    const int* position;        // (body,) position of its rows in the system, counted in bodies
    const float* qM;            // (nv,) diagonal of M
    const float* qacc_smooth;   // (nv,) accelerations without contacts
    double* qacc;               // (nv,)
    double* search;             // (nv,)
    double* grad;               // (nv,)
    double* Jaref;              // (contact, 3) J·qacc − aref
    double* jv;                 // (contact, 3) J·search
    double* force;              // (contact, 3)
    float* curvature;           // (contact, 6)
    float* drag;                // (contact, 2)
    float* excess;              // (contact,) excess that Jaref includes; negative: does not slide
    int* bodies_conadr;         // (pair,) first contact of each pair of moving bodies

    inline CUDA_CALLABLE Numbers contact(int k) const { return Numbers(efc, nconmax, k); }
};

}  // namespace petmjx

#endif
