// One contact's part in the solver: its rows of J, and the force and curvature of its cone's cost.
//
// `contact` points to the contact's numbers as the kernel make_rows writes them: frame (9), moment arms of both bodies
// (9 + 9), reference accelerations (3), stiffness of the normal's row (1), friction (1).

#ifndef PETMJX_CONTACT_CUH
#define PETMJX_CONTACT_CUH

namespace petmjx {

// J·x of one contact, (3,). `block`: the numbers of its two blocks, negative if the body does not move.
inline CUDA_CALLABLE void relative(const float* contact, const int* block, const double* x, double* out) {
    const int one = 6 * block[0], two = 6 * block[1];
    for (int r = 0; r < 3; ++r) {
        double value = 0.0;
        for (int i = 0; i < 3; ++i) {
            if (one >= 0) value -= contact[3 * r + i] * x[one + i] + contact[9 + 3 * r + i] * x[one + 3 + i];
            if (two >= 0) value += contact[3 * r + i] * x[two + i] + contact[18 + 3 * r + i] * x[two + 3 + i];
        }
        out[r] = value;
    }
}

// Force (3,) and curvature (6: the upper triangle, row by row) of a contact's cost at residual j = J·a − r, in its
// frame. The formulas are those of mj_constraintUpdate (MuJoCo, engine_core_constraint.c); both tangents have the same
// friction here. `slack`: 1 / √impratio, which makes the rows of an elliptic cone's tangents impratio times as stiff.
inline CUDA_CALLABLE void respond(
    int pyramidal, double slack, const double* j, const float* contact, double* push, double* bend
) {
    const double D = contact[30], mu = contact[31];
    for (int i = 0; i < 3; ++i) push[i] = 0.0;
    for (int i = 0; i < 6; ++i) bend[i] = 0.0;
    if (pyramidal) {
        for (int edge = 0; edge < 4; ++edge) {
            const double t = edge & 1 ? -mu : mu;
            const int side = 1 + (edge >> 1);
            const double r = j[0] + t * j[side];
            if (r >= 0.0) continue;
            push[0] -= D * r;
            push[side] -= D * r * t;
            bend[0] += D;
            bend[side] += D * t;
            bend[side == 1 ? 3 : 5] += D * t * t;
        }
        return;
    }
    const double tangent = sqrt(j[1] * j[1] + j[2] * j[2]);
    const double m = mu * slack;
    const double N = m * j[0], T = mu * tangent;
    if (N >= m * T) return;
    if (m * N + T <= 0.0) {
        const double Dt = D / (slack * slack);
        push[0] = -D * j[0];
        push[1] = -Dt * j[1];
        push[2] = -Dt * j[2];
        bend[0] = D;
        bend[3] = bend[5] = Dt;
        return;
    }
    const double Dm = D / (m * m * (1.0 + m * m)), gap = N - m * T;
    const double x = j[1] / tangent, y = j[2] / tangent;
    push[0] = -Dm * gap * m;
    push[1] = -push[0] * mu * x;
    push[2] = -push[0] * mu * y;
    const double along = Dm * m * m * mu * mu, across = -Dm * gap * m * mu / tangent;
    bend[0] = Dm * m * m;
    bend[1] = -Dm * m * m * mu * x;
    bend[2] = -Dm * m * m * mu * y;
    bend[3] = along * x * x + across * y * y;
    bend[4] = (along - across) * x * y;
    bend[5] = along * y * y + across * x * x;
}

}  // namespace petmjx

#endif
