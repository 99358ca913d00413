// Symmetric matrices of order up to four, row by row with a stride of four.
#pragma once
#include <algorithm>
#include <cmath>

namespace small {

using Matrix = double[16];

// S = L L^T; false where S is not positive definite.
inline bool cholesky(const double* S, double* L, int d) {
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
}

inline double log_determinant(const double* L, int d) {
    double sum = 0.0;
    for (int i = 0; i < d; i++) sum += std::log(L[5 * i]);
    return 2.0 * sum;
}

// (L L^T)^-1
inline void inverse(const double* L, double* out, int d) {
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
}

inline void product(const double* A, const double* B, double* C, int d) {
    for (int i = 0; i < d; i++)
        for (int j = 0; j < d; j++) {
            double s = 0.0;
            for (int k = 0; k < d; k++) s += A[4 * i + k] * B[4 * k + j];
            C[4 * i + j] = s;
        }
}

inline double inner(const double* A, const double* B, int d) {
    double s = 0.0;
    for (int i = 0; i < d; i++)
        for (int j = 0; j < d; j++) s += A[4 * i + j] * B[4 * i + j];
    return s;
}

// sym(A B C)
inline void symmetric_product(const double* A, const double* B, const double* C, double* out, int d) {
    Matrix t, u;
    product(A, B, t, d);
    product(t, C, u, d);
    for (int i = 0; i < d; i++)
        for (int j = 0; j < d; j++) out[4 * i + j] = 0.5 * (u[4 * i + j] + u[4 * j + i]);
}

// Smallest eigenvalue, by Jacobi's rotations.
inline double smallest_eigenvalue(double* A, int d) {
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

// The largest a with L L^T + a D >= 0.
inline double longest_step(const double* L, const double* D, int d) {
    if (d == 1) return D[0] < -1e-12 * L[0] * L[0] ? -L[0] * L[0] / D[0] : 1e12;
    Matrix t, u;
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
        }
    for (int i = 0; i < d; i++)
        for (int j = 0; j < i; j++) u[4 * i + j] = u[4 * j + i] = 0.5 * (u[4 * i + j] + u[4 * j + i]);
    double least = smallest_eigenvalue(u, d);
    return least < -1e-12 ? -1.0 / least : 1e12;
}

}  // namespace small
