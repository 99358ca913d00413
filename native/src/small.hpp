// Symmetric matrices of order up to four, row by row with a stride of four; entries beyond their order are zero.
#pragma once
#include <algorithm>
#include <cmath>
#include <type_traits>

namespace small {

using Matrix = double[16];

// f(d), with loops unrolled where d is four or one.
template <class F>
inline auto at_order(int d, F f) {
    if (d == 4) return f(std::integral_constant<int, 4>());
    if (d == 1) return f(std::integral_constant<int, 1>());
    return f(d);
}

// S = L L^T; false where S is not positive definite.
inline bool cholesky(const double* S, double* L, int order) {
    return at_order(order, [&](auto d) {
        for (int i = 0; i < d; i++)
            for (int j = 0; j <= i; j++) {
                double s = S[4 * i + j];
                for (int k = 0; k < j; k++) s -= L[4 * i + k] * L[4 * j + k];
                if (i == j) {
                    if (!(s > 0.0)) return false;
                    L[5 * i] = std::sqrt(s);
                } else {
                    L[4 * i + j] = s / L[5 * j];
                }
            }
        return true;
    });
}

inline double log_determinant(const double* L, int d) {
    double product = 1.0;
    for (int i = 0; i < d; i++) product *= L[5 * i];
    if (product > 1e-290 && product < 1e290) return 2.0 * std::log(product);
    double sum = 0.0;
    for (int i = 0; i < d; i++) sum += std::log(L[5 * i]);
    return 2.0 * sum;
}

// (L L^T)^-1
inline void inverse(const double* L, double* out, int order) {
    at_order(order, [&](auto d) {
        Matrix inv = {};
        for (int j = 0; j < d; j++) {
            inv[5 * j] = 1.0 / L[5 * j];
            for (int i = j + 1; i < d; i++) {
                double s = 0.0;
                for (int k = j; k < i; k++) s -= L[4 * i + k] * inv[4 * k + j];
                inv[4 * i + j] = s / L[5 * i];
            }
        }
        for (int i = 0; i < d; i++)
            for (int j = 0; j <= i; j++) {
                double s = 0.0;
                for (int k = i; k < d; k++) s += inv[4 * k + i] * inv[4 * k + j];
                out[4 * i + j] = out[4 * j + i] = s;
            }
    });
}

inline void product(const double* A, const double* B, double* C) {
    for (int i = 0; i < 4; i++) {
        double row[4] = {};
        for (int k = 0; k < 4; k++)
            for (int j = 0; j < 4; j++) row[j] += A[4 * i + k] * B[4 * k + j];
        for (int j = 0; j < 4; j++) C[4 * i + j] = row[j];
    }
}

inline double inner(const double* A, const double* B, int d) {
    if (d == 1) return A[0] * B[0];
    double s[4] = {};
    for (int i = 0; i < 4; i++)
        for (int j = 0; j < 4; j++) s[j] += A[4 * i + j] * B[4 * i + j];
    return (s[0] + s[1]) + (s[2] + s[3]);
}

// sym(A B C)
inline void symmetric_product(const double* A, const double* B, const double* C, double* out, int d) {
    if (d == 1) {
        std::fill(out, out + 16, 0.0);
        out[0] = A[0] * B[0] * C[0];
        return;
    }
    Matrix t, u;
    product(A, B, t);
    product(t, C, u);
    for (int i = 0; i < 4; i++)
        for (int j = 0; j < 4; j++) out[4 * i + j] = 0.5 * (u[4 * i + j] + u[4 * j + i]);
}

// Smallest eigenvalue, by Jacobi's rotations.
template <class D>
inline double smallest_eigenvalue(double* A, D d) {
    for (int sweep = 0; sweep < 12; sweep++) {
        double off = 0.0, on = 0.0;
        for (int p = 0; p < d; p++) {
            on += A[5 * p] * A[5 * p];
            for (int q = p + 1; q < d; q++) off += A[4 * p + q] * A[4 * p + q];
        }
        if (off <= 1e-14 * on) break;
        for (int p = 0; p < d; p++)
            for (int q = p + 1; q < d; q++) {
                double apq = A[4 * p + q];
                if (apq == 0.0) continue;
                double ratio = (A[5 * q] - A[5 * p]) / (2.0 * apq);
                double t = (ratio >= 0.0 ? 1.0 : -1.0) / (std::fabs(ratio) + std::sqrt(ratio * ratio + 1.0));
                double c = 1.0 / std::sqrt(t * t + 1.0), s = t * c;
                for (int k = 0; k < d; k++) {
                    double x = A[4 * k + p], y = A[4 * k + q];
                    A[4 * k + p] = c * x - s * y;
                    A[4 * k + q] = s * x + c * y;
                }
                for (int k = 0; k < d; k++) {
                    double x = A[4 * p + k], y = A[4 * q + k];
                    A[4 * p + k] = c * x - s * y;
                    A[4 * q + k] = s * x + c * y;
                }
            }
    }
    double least = A[0];
    for (int p = 1; p < d; p++) least = std::min(least, A[5 * p]);
    return least;
}

// The largest a with L L^T + a D >= 0; where that is certainly above FAR, some number that is.
constexpr double FAR = 1.25;
inline double longest_step(const double* L, const double* D, int order) {
    if (order == 1) return D[0] < -1e-12 * L[0] * L[0] ? -L[0] * L[0] / D[0] : 1e12;
    return at_order(order, [&](auto d) {
        Matrix t, u;
        double squares = 0.0;
        for (int j = 0; j < d; j++)
            for (int i = 0; i < d; i++) {
                double s = D[4 * i + j];
                for (int k = 0; k < i; k++) s -= L[4 * i + k] * t[4 * k + j];
                t[4 * i + j] = s / L[5 * i];
            }
        for (int j = 0; j < d; j++)
            for (int i = 0; i < d; i++) {
                double s = t[4 * j + i];
                for (int k = 0; k < i; k++) s -= L[4 * i + k] * u[4 * k + j];
                u[4 * i + j] = s / L[5 * i];
                squares += u[4 * i + j] * u[4 * i + j];
            }
        if (squares * FAR * FAR < 0.99) return 1.001 * FAR;  // no eigenvalue is larger than the matrix
        for (int i = 0; i < d; i++)
            for (int j = 0; j < i; j++) u[4 * i + j] = u[4 * j + i] = 0.5 * (u[4 * i + j] + u[4 * j + i]);
        const double least = smallest_eigenvalue(u, d);
        return least < -1e-12 ? -1.0 / least : 1e12;
    });
}

}  // namespace small
