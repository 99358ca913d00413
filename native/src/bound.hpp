// A number that is certainly <= the optimum over {theta feasible, |theta_k| <= bound_k}, from any multipliers.
//
// |r|^2 >= 2 y^T r - y^T y for every y, <S, F(theta)> >= 0 for S = V V^T, and -log det P >= log det S + 4 - <S, P>:
// what is left of the slope costs |e|^T bound. Each sum carries the error bound of any order of summation,
// |fl - true| <= gamma_n sum |terms| (Higham 2002, sec. 3.1), in extended precision: the package's
// solvers/verified.py in C++.
#pragma once
#include <limits>

#include "problem.hpp"

using Long = long double;

struct Sum {
    Long value = 0.0L, size = 0.0L, extra = 0.0L;
    int terms = 0;

    void add(Long x) {
        value += x;
        size += std::fabs(x);
        terms++;
    }
    // Each term is a product of at most four doubles; the factor two covers the rounding of ``size`` itself.
    Long radius() const {
        const Long unit = std::numeric_limits<Long>::epsilon();
        return 2.0L * (terms + 10) * unit * size + extra + (terms + 1) * 1e-300L;
    }
};

class LowerBound {
public:
    LowerBound(const Problem& problem, const Data& data) : problem_(problem), data_(data), p_(problem.p) {
        factors_.assign(16 * problem.blocks.size(), 0.0);
    }

    // -infinity where no multiplier is positive definite.
    double of(const double* theta, const double* multipliers) {
        y_.resize(data_.rows);
        for (int k = 0; k < data_.rows; k++) {
            Long r = -Long(data_.rho[k]);
            const double* row = data_.row(k);
            for (int j = data_.first[k]; j < p_; j++) r += Long(row[j]) * theta[j];
            y_[k] = double(r);
        }
        std::vector<double> used(multipliers, multipliers + factors_.size());
        for (std::size_t b = 0; b < problem_.blocks.size(); b++)
            if (!factor(b, &used[16 * b])) return -HUGE_VAL;
        double best = add_up();
        for (int round = 0; round < 4; round++) {
            const std::vector<double> kept = y_, factors = factors_;
            shift(used);
            const double better = add_up();
            if (!(better > best)) {
                y_ = kept;
                factors_ = factors;
                break;
            }
            const bool enough = better - best <= ENOUGH * std::fabs(better);
            best = better;
            if (enough) break;
        }
        return best;
    }

private:
    // A round that gains less than this share is the last: the next would gain a thousandth of it.
    static constexpr double ENOUGH = 1e-9;

    const Problem& problem_;
    const Data& data_;
    int p_;
    std::vector<double> factors_, y_;
    std::vector<Sum> slope_;
    Sum constant_;

    bool factor(std::size_t b, const double* Z) {
        const Block& B = problem_.blocks[b];
        double S[16];
        const double share = B.weight > 0.0 ? 1.0 / B.weight : 1.0;
        for (int e = 0; e < 16; e++) S[e] = share * Z[e];
        double L[16] = {};
        if (!small::cholesky(S, L, B.d)) return false;
        std::copy(L, L + 16, &factors_[16 * b]);
        return true;
    }

    void subtract(const Block& B, const double* L) {
        const Long factor = B.weight > 0.0 ? Long(B.weight) : 1.0L;
        Long S[16] = {}, size[16] = {};
        for (int i = 0; i < B.d; i++)
            for (int j = 0; j < B.d; j++)
                for (int c = 0; c <= std::min(i, j); c++) {
                    const Long x = Long(L[4 * i + c]) * L[4 * j + c];
                    S[4 * i + j] += x;
                    size[4 * i + j] += std::fabs(x);
                }
        for (int place = 0; place < B.d * B.d; place++) {
            const int e = 4 * (place / B.d) + place % B.d;
            const Long inverse = B.weight > 0.0 ? Long(B.nominal_inverse[e]) : 0.0L;
            add(constant_, factor * (inverse - S[e]) * B.constant[e],
                factor * (size[e] + std::fabs(inverse)) * std::fabs(Long(B.constant[e])));
            for (std::size_t i = 0; i < B.indices.size(); i++) {
                const double c = B.coefficients[16 * i + e];
                if (c != 0.0)
                    add(slope_[B.indices[i]], factor * (inverse - S[e]) * c,
                        factor * (size[e] + std::fabs(inverse)) * std::fabs(Long(c)));
            }
        }
        if (B.weight > 0.0) {
            for (int i = 0; i < B.d; i++) {
                const Long log = 2.0L * std::log(Long(L[5 * i]));
                add(constant_, factor * log, factor * (std::fabs(log) + 1.0L));
            }
            constant_.add(factor * B.nominal_log_determinant);
        }
    }

    // A term that was itself summed from four products, of absolute sum ``size``.
    static void add(Sum& sum, Long x, Long size) {
        sum.value += x;
        sum.size += 4.0L * size;
        sum.terms++;
    }

    double add_up() {
        constant_ = Sum();
        slope_.assign(p_, Sum());
        for (std::size_t b = 0; b < problem_.blocks.size(); b++) subtract(problem_.blocks[b], &factors_[16 * b]);
        constant_.add(Long(data_.residual_norm) * data_.residual_norm);
        std::vector<double> size(p_, 0.0);  // in doubles: the factor two of Sum::radius covers that
        for (int k = 0; k < data_.rows; k++) {
            const Long y = y_[k];
            constant_.add(-2.0L * y * data_.rho[k]);
            constant_.add(-y * y);
            const double* row = data_.row(k);
            const double twice = 2.0 * std::fabs(y_[k]);
            for (int j = data_.first[k]; j < p_; j++) slope_[j].value += 2.0L * y * row[j];
            for (int j = data_.first[k]; j < p_; j++) size[j] += std::fabs(twice * row[j]);
        }
        for (int j = 0; j < p_; j++) slope_[j].size += size[j], slope_[j].terms += data_.rows;
        Long reach = 0.0L;
        for (int j = 0; j < p_; j++) reach += (std::fabs(slope_[j].value) + slope_[j].radius()) * problem_.bound[j];
        const Long unit = std::numeric_limits<Long>::epsilon();
        reach *= 1.0L + 4.0L * (p_ + 4) * unit;
        Long lower = constant_.value - constant_.radius() - reach;
        lower -= 8.0L * unit * (std::fabs(constant_.value) + reach);
        return std::nextafter(double(lower), -HUGE_VAL);
    }

    // Move y and the multipliers so that less of the slope is left over.
    void shift(std::vector<double>& used) {
        std::vector<int> owner(p_, -1);
        for (std::size_t b = 0; b < problem_.blocks.size(); b++)
            if (!problem_.blocks[b].spread.empty())
                for (int k : problem_.blocks[b].indices) owner[k] = int(b);
        if (own_.empty())
            for (int j = 0; j < p_; j++)
                if (owner[j] < 0) own_.push_back(j);
        std::vector<Long> left(p_);
        for (int j = 0; j < p_; j++) left[j] = slope_[j].value;
        shift_residual(left);
        // The slope after that, into the multipliers of each link's matrix, which can hold any of it.
        for (std::size_t b = 0; b < problem_.blocks.size(); b++) {
            const Block& B = problem_.blocks[b];
            if (B.spread.empty() || owner[B.indices[0]] != int(b)) continue;
            double trial[16];
            std::copy(&used[16 * b], &used[16 * b] + 16, trial);
            for (std::size_t i = 0; i < B.indices.size(); i++)
                for (int e = 0; e < 16; e++) trial[e] += double(left[B.indices[i]]) * B.spread[16 * i + e];
            if (factor(b, trial)) std::copy(trial, trial + 16, &used[16 * b]);
        }
    }

    // y moved so that the slope of the parameters own_, which no link's matrix holds, vanishes; left (p,) with it.
    void shift_residual(std::vector<Long>& left) {
        const int r = data_.rows;
        int m = int(own_.size()), one = 1, info = 0;
        char lower = 'L';
        if (m == 0 || r == 0) return;
        if (columns_.empty()) {
            columns_.resize(std::size_t(m) * r);
            gram_.resize(std::size_t(m) * m);
            for (int a = 0; a < m; a++)
                for (int k = 0; k < r; k++) columns_[std::size_t(r) * a + k] = data_.row(k)[own_[a]];
            for (int a = 0; a < m; a++)
                for (int c = 0; c <= a; c++) {
                    const double s = 2.0 * dot(&columns_[std::size_t(r) * a], &columns_[std::size_t(r) * c], r);
                    gram_[std::size_t(m) * c + a] = a == c && s == 0.0 ? 1.0 : s;
                }
            problem_.lapack.potrf(&lower, &m, gram_.data(), &m, &info);
            solvable_ = info == 0;
        }
        if (!solvable_) return;
        std::vector<double> right(m);
        for (int a = 0; a < m; a++) right[a] = double(left[own_[a]]);
        problem_.lapack.potrs(&lower, &m, &one, gram_.data(), &m, right.data(), &m, &info);
        const std::vector<double> before = y_;
        for (int a = 0; a < m; a++)
            for (int k = 0; k < r; k++) y_[k] -= columns_[std::size_t(r) * a + k] * right[a];
        for (int k = 0; k < r; k++) {
            const Long twice = 2.0L * (Long(y_[k]) - before[k]);
            const double* row = data_.row(k);
            for (int j = data_.first[k]; j < p_; j++) left[j] += twice * row[j];
        }
    }

    std::vector<int> own_;
    std::vector<double> columns_, gram_;  // of own_: (own, rows), and the Cholesky factor of 2 A^T A
    bool solvable_ = false;
};
