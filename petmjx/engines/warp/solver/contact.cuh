// One contact in the solver: its rows of J, and the force and curvature of its cone's cost.
//
// `contact`: the contact's numbers, as make_constraint (kernels/contact_rows.py) writes them: frame (9), moment arms of
// both bodies (9 + 9), reference accelerations (aref, 3), stiffness of the normal's row (D, 1), friction (1).

#ifndef PETMJX_CONTACT_CUH
#define PETMJX_CONTACT_CUH

#include "block.cuh"
#include "body_vectors.cuh"
#include "efc.cuh"

namespace petmjx {

const double TINY = 1e-30;  // instead of zero as a divisor

inline CUDA_CALLABLE double larger(double x, double y) { return x > y ? x : y; }

// Frame of a contact: three axes, one after another.
inline CUDA_CALLABLE void load_axes(const Numbers& contact, float (&axes)[9]) {
    contact.load(axes, 0);
    contact.load(axes + 4, 1);
    axes[8] = contact[8];
}

// Moment arms of a contact's first (side 0) or second body (side 1), one axis after the other.
inline CUDA_CALLABLE void load_arms(const Numbers& contact, int side, float (&arms)[9]) {
    float near[12];
    #pragma unroll
    for (int i = 0; i < 3; ++i) contact.load(near + 4 * i, 2 + 2 * side + i);
    #pragma unroll
    for (int i = 0; i < 9; ++i) arms[i] = side ? near[2 + i] : near[1 + i];
}

// J·x of one contact, (3,). `body`: the numbers of its two bodies; negative: the body does not move.
#if defined(__CUDA_ARCH__)
inline CUDA_CALLABLE void relative(const Numbers& contact, const int* body, const double* x, double* out) {
    const int one = 6 * body[0], two = 6 * body[1];
    float axes[28];
    #pragma unroll
    for (int i = 0; i < 7; ++i) contact.load(axes + 4 * i, i);
    const float* of_one = axes + 9;
    const float* of_two = axes + 18;
    double value[3] = {0.0, 0.0, 0.0};
    #pragma unroll
    for (int i = 0; i < 3; ++i) {
        if (one >= 0) {
            const double along = x[one + i], about = x[one + 3 + i];
            #pragma unroll
            for (int r = 0; r < 3; ++r) value[r] -= axes[3 * r + i] * along + of_one[3 * r + i] * about;
        }
        if (two >= 0) {
            const double along = x[two + i], about = x[two + 3 + i];
            #pragma unroll
            for (int r = 0; r < 3; ++r) value[r] += axes[3 * r + i] * along + of_two[3 * r + i] * about;
        }
    }
    for (int r = 0; r < 3; ++r) out[r] = value[r];
}
#else
inline void relative(const Numbers& contact, const int* body, const double* x, double* out) {
    typedef double Four __attribute__((ext_vector_type(4)));
    const SixDoubles one = load_six_doubles(x, body[0]), two = load_six_doubles(x, body[1]);
    Four four[3];
    #pragma unroll
    for (int r = 0; r < 3; ++r) {
        const SixDoubles parts = as_doubles(load_six(contact, 1, r)) * two - as_doubles(load_six(contact, 0, r)) * one;
        four[r] = parts.lo + parts.hi;
    }
    const Four pairs = __builtin_shufflevector(four[0], four[1], 0, 4, 2, 6)
        + __builtin_shufflevector(four[0], four[1], 1, 5, 3, 7);
    const auto sums = pairs.lo + pairs.hi;
    out[0] = sums.x;
    out[1] = sums.y;
    out[2] = (four[2].x + four[2].y) + (four[2].z + four[2].w);
}
#endif

// Force (3,) and curvature (6: the upper triangle, row by row) of a contact's cost at residual j = J·qacc − aref, in
// its frame. The formulas are those of mj_constraintUpdate (MuJoCo, engine_core_constraint.c); both tangents have the same
// friction here. `impratio_invsqrt`: 1 / √impratio, which makes the rows of an elliptic cone's tangents impratio times as
// stiff.
//
// `drag` (2,) is the friction as a share of the largest possible friction, with opposite sign, |drag| ≤ 1. It is an
// unknown of its own for a sliding contact, and a result for other contacts; newton.py explains this. With `anew` it is
// computed from the residual. Pyramidal cones have no drag.
inline PETMJX_INLINED CUDA_CALLABLE void respond(
    int pyramidal, double impratio_invsqrt, const double* j, const Numbers& contact, bool anew,
    float* drag, double* push, double* bend
) {
    float last[4];
    contact.load(last, 7);
    const double D = last[2], mu = last[3];
    for (int i = 0; i < 3; ++i) push[i] = 0.0;
    for (int i = 0; i < 6; ++i) bend[i] = 0.0;
    if (pyramidal) {
        for (int edge = 0; edge < 4; ++edge) {
            const double t = edge & 1 ? -mu : mu;
            const int side = 1 + (edge >> 1);
            const double r = j[0] + t * j[side];
            if (r >= 0.0) continue;
            const double Dr = times(D, r), Dt = times(D, t);
            push[0] -= Dr;
            push[side] -= Dr * t;
            bend[0] += D;
            bend[side] += Dt;
            bend[side == 1 ? 3 : 5] += Dt * t;
        }
        return;
    }
    const double tangent = sqrt(j[1] * j[1] + j[2] * j[2]);
    const double m = mu * impratio_invsqrt;
    const double N = times(m, j[0]), T = times(mu, tangent), most_N = times(m, T);
    if (N >= most_N) {
        drag[0] = drag[1] = 0.0f;
        return;
    }
    if (m * N + T <= 0.0) {
        const double Dt = D / (impratio_invsqrt * impratio_invsqrt);
        push[0] = -D * j[0];
        push[1] = -Dt * j[1];
        push[2] = -Dt * j[2];
        const double most = larger(mu * push[0], TINY);
        drag[0] = (float)(-push[1] / most);
        drag[1] = (float)(-push[2] / most);
        bend[0] = D;
        bend[3] = bend[5] = Dt;
        return;
    }
    const double Dm = D / (times(m, m) * fused(m, m, 1.0)), gap = N - most_N;
    const double x = j[1] / tangent, y = j[2] / tangent;
    push[0] = -Dm * gap * m;
    push[1] = -push[0] * mu * x;
    push[2] = -push[0] * mu * y;
    if (anew) drag[0] = (float)x, drag[1] = (float)y;
    const double along = Dm * m * m * mu * mu, across = -Dm * gap * m * mu / tangent, u = drag[0], v = drag[1];
    bend[0] = Dm * m * m;
    bend[1] = -Dm * m * m * mu * x;
    bend[2] = -Dm * m * m * mu * y;
    bend[3] = along * x * x + across * (1.0 - u * x);
    bend[4] = along * x * y - 0.5 * across * (u * y + v * x);
    bend[5] = along * y * y + across * (1.0 - v * y);
}

// Updates the excess of a sliding contact from the residual j, and with it j's normal part:
// petmjx/world/contact_laws.py. `begins`: whether j belongs to the accelerations from which the solver starts. If not,
// `push` is the force at j. Returns whether j has changed.
inline CUDA_CALLABLE bool correct(
    double impratio_invsqrt, double slack, bool begins, const double* push, const Numbers& contact, double* j, float* excess
) {
    float last[4];
    contact.load(last, 7);
    const double mu = last[3], tangent = sqrt(j[1] * j[1] + j[2] * j[2]);
    if (begins) {
        const double most = *excess, beyond = larger(tangent - slack, 0.0);
        *excess = (float)(beyond < most ? beyond : most);
        j[0] += mu * *excess;
        return true;
    }
    const double dragged = sqrt(push[1] * push[1] + push[2] * push[2]) * (impratio_invsqrt * impratio_invsqrt) / last[2];
    const double change = larger(tangent - dragged - slack, 0.0) - *excess, pressed = mu * change;
    if (pressed <= PETMJX_SLIP_ENOUGH && pressed >= -PETMJX_SLIP_ENOUGH) return false;
    const float next = (float)(*excess + PETMJX_SLIP_RELAXATION * change);
    j[0] += mu * ((double)next - *excess);
    *excess = next;
    return true;
}

// Whether a contact may slide at residual j, by the conditions of `respond` without their roots. If it surely does not,
// `respond` replaces its drag.
inline CUDA_CALLABLE bool may_slide(double impratio_invsqrt, const double* j, const Numbers& contact) {
#if defined(__CUDA_ARCH__)
    return true;  // threads of a warp would wait for those whose contacts slide
#else
    const double MORE = 1.0 + 1e-9;  // by far more than rounding
    const double mu = contact[31], m = mu * impratio_invsqrt, N = m * j[0];
    const double square = MORE * mu * mu * (j[1] * j[1] + j[2] * j[2]);
    return !(N < 0.0 ? m * m * N * N > square : N * N > m * m * square);
#endif
}

// Updates `drag` for a whole step of Newton's method that changes the residual j by v. If the contact does not slide
// afterwards, `respond` replaces this value.
inline CUDA_CALLABLE void follow(const double* j, const double* v, float* drag) {
    const double tangent = larger(sqrt(j[1] * j[1] + j[2] * j[2]), TINY);
    const double x = j[1] / tangent, y = j[2] / tangent, change = x * v[1] + y * v[2];
    const double one = x + (v[1] - drag[0] * change) / tangent, two = y + (v[2] - drag[1] * change) / tangent;
    const double most = larger(sqrt(one * one + two * two), 1.0);
    drag[0] = (float)(one / most);
    drag[1] = (float)(two / most);
}

// Adds the first and second derivative of a contact's cost with respect to `length`, at residual j + length·v. The
// results of `respond` at this residual, multiplied by v once and twice, are the same derivatives, but take more
// operations.
inline PETMJX_INLINED CUDA_CALLABLE void respond_along(
    int pyramidal, double impratio_invsqrt, const double* j, const double* v, double length, const Numbers& contact,
    double (&cost)[2]
) {
    float last[4];
    contact.load(last, 7);
    const double D = last[2], mu = last[3];
    const double normal = j[0] + length * v[0], one = j[1] + length * v[1], two = j[2] + length * v[2];
    if (pyramidal) {
        for (int edge = 0; edge < 4; ++edge) {
            const double t = edge & 1 ? -mu : mu, side = edge >> 1 ? two : one;
            const double r = normal + t * side, change = v[0] + t * v[1 + (edge >> 1)];
            if (r >= 0.0) continue;
            cost[0] += D * r * change;
            cost[1] += D * change * change;
        }
        return;
    }
    const double square = one * one + two * two, m = mu * impratio_invsqrt;
    const double mixed = one * v[1] + two * v[2], speed = v[1] * v[1] + v[2] * v[2];
    const double N = times(m, normal);
    if (N >= 0.0 && N * N >= m * m * mu * mu * square) return;
    if (N <= 0.0 && m * m * N * N >= mu * mu * square) {
        const double Dt = D / (impratio_invsqrt * impratio_invsqrt);
        cost[0] += D * normal * v[0] + Dt * mixed;
        cost[1] += D * v[0] * v[0] + Dt * speed;
        return;
    }
    const double tangent = sqrt(square), turned = mixed / tangent;
    const double Dm = D / (times(m, m) * fused(m, m, 1.0)), m_mu = times(m, mu);
    const double gap = fused(-m_mu, tangent, N), change = fused(m, v[0], -times(m_mu, turned));
    cost[0] += Dm * gap * change;
    cost[1] += Dm * (change * change - gap * m * mu * (speed - turned * turned) / tangent);
}

}  // namespace petmjx

#endif
