// A primal-dual interior-point method (HKM direction, Mehrotra's predictor and corrector) that knows the
// problem's structure: small blocks and one dense Gram matrix.
#pragma once
#include "problem.hpp"

struct Answer {
    std::vector<double> theta;        // (p,)
    std::vector<double> multipliers;  // (blocks, 4, 4)
    int iterations = 0;
    bool converged = false;
    double gap = HUGE_VAL;  // its own, relative; nobody believes it
};

class InteriorPoint {
public:
    InteriorPoint(const Problem& problem, const Data& data) : problem_(problem), data_(data), p_(problem.p) {
        const std::size_t b = problem.blocks.size();
        for (auto* v : {&S_, &Z_, &LS_, &LZ_, &SI_, &dS_, &dZ_, &gapS_, &C_}) v->assign(16 * b, 0.0);
        gram_.assign(std::size_t(p_) * p_, 0.0);
        H_.resize(gram_.size());
        for (auto* v : {&gradient_, &right_, &step_, &dual_}) v->assign(p_, 0.0);
        char lower = 'L', plain = 'N';
        int p = p_, r = data.rows;
        double two = 2.0, zero = 0.0;
        // R row by row is R^T column by column.
        if (r > 0)
            problem.lapack.syrk(&lower, &plain, &p, &r, &two, const_cast<double*>(data.R), &p, &zero,
                                gram_.data(), &p);
        for (const Block& block : problem.blocks) degree_ += block.d;
    }

    // warmth : the start's complementarity as a share of its objective; small where the start is near the optimum.
    Answer solve(const double* start, double warmth, double tolerance, int most) {
        Answer best;
        best.theta.assign(start, start + p_);
        if (!begin(start, warmth)) return best;
        double least = HUGE_VAL;
        for (int k = 0; k < most; k++) {
            residuals();
            const bool solvable = factorise();
            const double scale = std::max(std::fabs(value_), 1e-300);
            // Half the square of Newton's decrement: what the leftover slope costs where the data curve.
            const double cost = solvable ? decrement() : least * scale;
            const double error = (gap_ + infeasible_ + cost) / scale;
            if (error < least || k == 0) {
                least = error;
                keep(best, k, gap_ / scale);
            }
            best.converged |= error <= tolerance;
            if (best.converged || !solvable || !advance()) break;
        }
        return best;
    }

private:
    // Complementarity keeps this share of the start's for as long as that share of the slope is left.
    static constexpr double AHEAD = 0.1;
    // A step shorter than this is taken back towards the central path instead.
    static constexpr double JAMMED = 0.1;

    const Problem& problem_;
    const Data& data_;
    int p_, degree_ = 0;
    std::vector<double> gram_, H_, theta_, S_, Z_, LS_, LZ_, SI_, dS_, dZ_, gapS_, C_, gradient_, right_, step_,
        dual_;
    double value_ = 0.0, gap_ = 0.0, mu_ = 0.0, left_ = 1.0, infeasible_ = 0.0;

    const Block& block(std::size_t b) const { return problem_.blocks[b]; }
    std::size_t count() const { return problem_.blocks.size(); }

    void keep(Answer& best, int iteration, double gap) const {
        best.theta = theta_;
        best.multipliers = Z_;
        best.iterations = iteration;
        best.gap = gap;
    }

    // S = F(theta), lifted into the cone where theta is outside or on its boundary; S Z = mu 1.
    // False for numbers that are not finite.
    bool begin(const double* start, double warmth) {
        theta_.assign(start, start + p_);
        for (std::size_t b = 0; b < count(); b++) {
            double* S = &S_[16 * b];
            block(b).value(start, S);
            double largest = 1e-300;
            for (int e = 0; e < 16; e++) largest = std::max(largest, std::fabs(S[e]));
            double lift = 1e-8 * largest;
            while (!small::cholesky(S, &LS_[16 * b], block(b).d)) {
                if (!(lift < 1e3 * largest)) return false;
                for (int i = 0; i < block(b).d; i++) S[5 * i] += lift;
                lift *= 10.0;
            }
            small::inverse(&LS_[16 * b], &SI_[16 * b], block(b).d);
        }
        evaluate();
        const double mu = std::max(warmth * std::fabs(value_) / degree_, 1e-300);
        mu_ = mu;
        for (std::size_t b = 0; b < count(); b++) {
            const double size = std::max(mu, block(b).weight);
            for (int e = 0; e < 16; e++) Z_[16 * b + e] = size * SI_[16 * b + e];
            if (!small::cholesky(&Z_[16 * b], &LZ_[16 * b], block(b).d)) return false;
        }
        return true;
    }

    // Value and gradient of the smooth part without its logarithms.
    void evaluate() {
        value_ = data_.residual_norm * data_.residual_norm;
        for (int j = 0; j < p_; j++) {
            gradient_[j] = problem_.linear[j];
            value_ += problem_.linear[j] * theta_[j];
        }
        for (int k = 0; k < data_.rows; k++) {
            const double* row = data_.row(k);
            const int first = data_.first[k];
            const double r = dot(row + first, theta_.data() + first, p_ - first) - data_.rho[k];
            value_ += r * r;
            for (int j = first; j < p_; j++) gradient_[j] += 2.0 * r * row[j];
        }
    }

    void residuals() {
        evaluate();
        gap_ = infeasible_ = 0.0;
        dual_ = gradient_;
        for (std::size_t b = 0; b < count(); b++) {
            const Block& B = block(b);
            double F[16];
            B.value(theta_.data(), F);
            for (int i = 0; i < B.d; i++)
                for (int j = 0; j < B.d; j++) {
                    const int e = 4 * i + j;
                    gapS_[16 * b + e] = F[e] - S_[16 * b + e];
                }
            double off = 0.0;
            for (int i = 0; i < B.d; i++) off = std::max(off, std::fabs(gapS_[16 * b + 5 * i]) / S_[16 * b + 5 * i]);
            if (off < 1e-13) {
                for (int e = 0; e < 16; e++) gapS_[16 * b + e] = 0.0;
                off = 0.0;
            }
            const double both = small::inner(&S_[16 * b], &Z_[16 * b], B.d);
            infeasible_ += off * std::fabs(both);
            if (B.weight > 0.0) {
                const double logs = small::log_determinant(&LS_[16 * b], B.d) + small::log_determinant(&LZ_[16 * b], B.d);
                gap_ += both - B.d * B.weight - B.weight * (logs - B.d * std::log(B.weight));
            } else {
                gap_ += both;
            }
            B.adjoint(&Z_[16 * b], -1.0, dual_.data());
        }
        gap_ = std::max(gap_, 0.0);
    }

    // H = 2 R^T R + sum A^T W A, W the curvature sym(S^-1 . Z), lower triangle column by column.
    bool factorise() {
        H_ = gram_;
        for (std::size_t b = 0; b < count(); b++) {
            const Block& B = block(b);
            const int k = int(B.indices.size());
            if (B.d == 1) {
                const double curvature = SI_[16 * b] * Z_[16 * b];
                for (int i = 0; i < k; i++)
                    for (int j = 0; j < k; j++)
                        if (B.indices[i] >= B.indices[j])
                            H_[std::size_t(p_) * B.indices[j] + B.indices[i]] +=
                                curvature * B.coefficients[16 * i] * B.coefficients[16 * j];
                continue;
            }
            double images[10 * 16];
            for (int i0 = 0; i0 < k; i0 += 10) {
                const int m = std::min(10, k - i0);
                for (int i = 0; i < m; i++)
                    small::symmetric_product(&SI_[16 * b], &B.coefficients[16 * (i0 + i)], &Z_[16 * b], images + 16 * i, B.d);
                for (int i = 0; i < m; i++)
                    for (int j = 0; j < k; j++) {
                        const int row = B.indices[i0 + i], column = B.indices[j];
                        if (row >= column)
                            H_[std::size_t(p_) * column + row] += small::inner(images + 16 * i, &B.coefficients[16 * j], B.d);
                    }
            }
        }
        for (int j = 0; j < p_; j++) {
            double& diagonal = H_[std::size_t(p_) * j + j];
            diagonal += 1e-14 * diagonal + 1e-300;
        }
        char lower = 'L';
        int p = p_, info = 0;
        problem_.lapack.potrf(&lower, &p, H_.data(), &p, &info);
        return info == 0;
    }

    double decrement() {
        step_ = dual_;
        back_substitute();
        double sum = 0.0;
        for (int j = 0; j < p_; j++) sum += step_[j] * dual_[j];
        return 0.5 * std::max(sum, 0.0);
    }

    // H = L L^T, in place; LAPACK would copy L for each right-hand side.
    void back_substitute() {
        for (int j = 0; j < p_; j++) {
            const double* column = &H_[std::size_t(p_) * j];
            const double x = step_[j] /= column[j];
            for (int i = j + 1; i < p_; i++) step_[i] -= x * column[i];
        }
        for (int j = p_ - 1; j >= 0; j--) {
            const double* column = &H_[std::size_t(p_) * j];
            step_[j] = (step_[j] - dot(column + j + 1, step_.data() + j + 1, p_ - j - 1)) / column[j];
        }
    }

    double target(std::size_t b, double centring) const {
        return std::max(block(b).weight, centring);
    }

    // step_ from right-hand sides sum A^T (target S^-1 - C - W gapS) - gradient, and dS, dZ with it.
    void direction(double centring, bool corrected) {
        for (int j = 0; j < p_; j++) step_[j] = -gradient_[j];
        for (std::size_t b = 0; b < count(); b++) {
            double M[16], G[16];
            small::symmetric_product(&SI_[16 * b], &gapS_[16 * b], &Z_[16 * b], G, block(b).d);
            for (int e = 0; e < 16; e++)
                M[e] = target(b, centring) * SI_[16 * b + e] - (corrected ? C_[16 * b + e] : 0.0) - G[e];
            block(b).adjoint(M, 1.0, step_.data());
        }
        back_substitute();
        for (std::size_t b = 0; b < count(); b++) {
            double* D = &dS_[16 * b];
            block(b).direction(step_.data(), D);
            for (int e = 0; e < 16; e++) D[e] += gapS_[16 * b + e];
            double G[16];
            small::symmetric_product(&SI_[16 * b], D, &Z_[16 * b], G, block(b).d);
            for (int e = 0; e < 16; e++)
                dZ_[16 * b + e] = target(b, centring) * SI_[16 * b + e] - Z_[16 * b + e] - G[e] - (corrected ? C_[16 * b + e] : 0.0);
        }
    }

    double longest() const {
        double a = 1e12;
        for (std::size_t b = 0; b < count(); b++) {
            a = std::min(a, small::longest_step(&LS_[16 * b], &dS_[16 * b], block(b).d));
            a = std::min(a, small::longest_step(&LZ_[16 * b], &dZ_[16 * b], block(b).d));
        }
        return a;
    }

    bool advance() {
        direction(0.0, false);
        const double reach = std::min(1.0, 0.999 * longest());
        double now = 0.0, ahead = 0.0;
        for (std::size_t b = 0; b < count(); b++) {
            const int d = block(b).d;
            double S[16], Z[16];
            for (int e = 0; e < 16; e++) {
                S[e] = S_[16 * b + e] + reach * dS_[16 * b + e];
                Z[e] = Z_[16 * b + e] + reach * dZ_[16 * b + e];
            }
            now += std::fabs(small::inner(&S_[16 * b], &Z_[16 * b], d) - d * block(b).weight);
            ahead += std::fabs(small::inner(S, Z, d) - d * block(b).weight);
        }
        double centre = now > 0.0 ? std::pow(ahead / now, std::max(1.0, 3.0 * reach * reach)) : 0.0;
        centre = std::min(std::max(centre, 1e-7), 1.0);
        for (std::size_t b = 0; b < count(); b++)
            small::symmetric_product(&SI_[16 * b], &dS_[16 * b], &dZ_[16 * b], &C_[16 * b], block(b).d);
        // Complementarity must not run ahead of what is left of the slope, or the iterates jam at the boundary.
        direction(std::max(centre * now / degree_, AHEAD * mu_ * left_), true);
        double longest_step = longest();
        if (longest_step < JAMMED) {
            direction(now / degree_, false);
            longest_step = longest();
        }
        const double a = std::min(1.0, (0.9 + 0.09 * reach) * longest_step);
        if (!(a > 1e-10)) return false;
        left_ *= 1.0 - a;
        for (int j = 0; j < p_; j++) theta_[j] += a * step_[j];
        return renew(a);
    }

    bool renew(double a) {
        for (std::size_t b = 0; b < count(); b++) {
            const int d = block(b).d;
            double F[16];
            block(b).value(theta_.data(), F);
            double off = 0.0;
            for (int i = 0; i < d; i++) off = std::max(off, std::fabs(gapS_[16 * b + 5 * i]));
            for (int e = 0; e < 16; e++) {
                S_[16 * b + e] = (off == 0.0 || a == 1.0) ? F[e] : S_[16 * b + e] + a * dS_[16 * b + e];
                Z_[16 * b + e] += a * dZ_[16 * b + e];
            }
            if (!small::cholesky(&S_[16 * b], &LS_[16 * b], d)) return false;
            if (!small::cholesky(&Z_[16 * b], &LZ_[16 * b], d)) return false;
            small::inverse(&LS_[16 * b], &SI_[16 * b], d);
        }
        return true;
    }
};
