// minimise |R theta - rho|^2 + linear^T theta - sum_b weight_b log det F_b(theta)   subject to   F_b(theta) >= 0,
// F_b(theta) = constant + sum_i theta[indices_i] coefficient_i of order one to four.
#pragma once
#include <cstring>
#include <vector>

#include "small.hpp"

using Potrf = void (*)(char*, int*, double*, int*, int*);
using Potrs = void (*)(char*, int*, int*, double*, int*, double*, int*, int*);
using Syrk = void (*)(char*, char*, int*, int*, double*, double*, int*, double*, double*, int*);

struct Lapack {
    Potrf potrf;
    Potrs potrs;
    Syrk syrk;
};

struct Block {
    int d = 1;
    double weight = 0.0;              // of -log det F, beside which F >= 0 needs no saying; 0: a plain cone
    std::vector<int> indices;         // (k,)
    std::vector<double> coefficients; // (k, 4, 4)
    double constant[16] = {};
    std::vector<double> spread;       // (k, 4, 4): from e to E with <coefficient_i, E> = e_i; may be empty
    double nominal_inverse[16] = {};  // P_0^-1 and log det P_0, with which the bound defines the entropy
    double nominal_log_determinant = 0.0;

    void value(const double* theta, double* F) const {
        std::memcpy(F, constant, sizeof constant);
        if (d == 1) {
            for (std::size_t i = 0; i < indices.size(); i++) F[0] += theta[indices[i]] * coefficients[16 * i];
            return;
        }
        for (std::size_t i = 0; i < indices.size(); i++) {
            const double* c = &coefficients[16 * i];
            for (int e = 0; e < 16; e++) F[e] += theta[indices[i]] * c[e];
        }
    }

    // sum_i step[indices_i] coefficient_i
    void direction(const double* step, double* D) const {
        std::memset(D, 0, 16 * sizeof(double));
        if (d == 1) {
            for (std::size_t i = 0; i < indices.size(); i++) D[0] += step[indices[i]] * coefficients[16 * i];
            return;
        }
        for (std::size_t i = 0; i < indices.size(); i++) {
            const double* c = &coefficients[16 * i];
            for (int e = 0; e < 16; e++) D[e] += step[indices[i]] * c[e];
        }
    }

    // out[indices_i] += factor <coefficient_i, M>
    void adjoint(const double* M, double factor, double* out) const {
        for (std::size_t i = 0; i < indices.size(); i++)
            out[indices[i]] += factor * small::inner(&coefficients[16 * i], M, d);
    }
};

// Whether theta lies inside by more than rounding can turn over: depth as in the package's constraints/cones.py.
inline bool safely_inside(const Block& block, const double* theta) {
    double F[16], terms[16], L[16];
    block.value(theta, F);
    for (int e = 0; e < 16; e++) terms[e] = std::fabs(block.constant[e]);
    for (std::size_t i = 0; i < block.indices.size(); i++)
        for (int e = 0; e < 16; e++) terms[e] += std::fabs(theta[block.indices[i]] * block.coefficients[16 * i + e]);
    const double margin = 64.0 * 4 * 2.3e-16;
    for (int i = 0; i < block.d; i++)
        for (int j = 0; j < block.d; j++) {
            const double size = std::sqrt(terms[5 * i] * terms[5 * j]);
            F[4 * i + j] = (size > 0.0 ? F[4 * i + j] / size : F[4 * i + j]) - (i == j ? margin : 0.0);
        }
    return small::cholesky(F, L, block.d);
}

struct Problem {
    int p = 0;
    std::vector<Block> blocks;
    std::vector<double> linear;  // (p,)
    std::vector<double> bound;   // (p,) |theta_k| <= bound_k
    Lapack lapack;
};

// sum_k a_k b_k in eight partial sums, which the compiler may not make of one by itself.
inline double dot(const double* a, const double* b, int n) {
    double part[8] = {};
    int k = 0;
    for (; k + 8 <= n; k += 8)
        for (int i = 0; i < 8; i++) part[i] += a[k + i] * b[k + i];
    for (; k < n; k++) part[0] += a[k] * b[k];
    return ((part[0] + part[4]) + (part[1] + part[5])) + ((part[2] + part[6]) + (part[3] + part[7]));
}

struct Data {
    int rows, p;
    const double *R, *rho;  // (rows, p) row by row, (rows,)
    double residual_norm;
    std::vector<int> first;  // (rows,) column of each row's first entry that is not zero: of a triangle, half are

    Data(int rows, int p, const double* R, const double* rho, double residual_norm)
        : rows(rows), p(p), R(R), rho(rho), residual_norm(residual_norm), first(rows, 0) {
        for (int k = 0; k < rows; k++)
            while (first[k] < p && row(k)[first[k]] == 0.0) first[k]++;
    }
    const double* row(int k) const { return R + std::size_t(k) * p; }
};
