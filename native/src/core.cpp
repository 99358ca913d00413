#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/tuple.h>

#include <cstdint>

#include "bound.hpp"
#include "interior_point.hpp"
#include "numbers.hpp"
#include "regressor.hpp"

namespace nb = nanobind;
using Doubles = nb::ndarray<const double, nb::c_contig, nb::device::cpu>;
using Integers = nb::ndarray<const std::int64_t, nb::c_contig, nb::device::cpu>;
using Out = nb::ndarray<double, nb::c_contig, nb::device::cpu>;

namespace {

void need(bool condition, const char* what) {
    if (!condition) throw nb::value_error(what);
}

// The blocks of a problem, kept between solves of different data.
class Structured {
public:
    explicit Structured(Doubles linear, Doubles bound, std::uintptr_t potrf, std::uintptr_t potrs, std::uintptr_t syrk) {
        problem_.p = int(linear.size());
        need(bound.size() == linear.size(), "bound");
        problem_.linear.assign(linear.data(), linear.data() + linear.size());
        problem_.bound.assign(bound.data(), bound.data() + bound.size());
        problem_.lapack = {reinterpret_cast<Potrf>(potrf), reinterpret_cast<Potrs>(potrs), reinterpret_cast<Syrk>(syrk)};
    }

    void add(int order, double weight, Integers indices, Doubles coefficients, Doubles constant, Doubles spread,
             Doubles nominal_inverse, double nominal_log_determinant) {
        const std::size_t k = indices.size();
        need(order >= 1 && order <= 4 && coefficients.size() == 16 * k && constant.size() == 16, "block");
        need(spread.size() == 0 || spread.size() == 16 * k, "spread");
        Block block;
        block.d = order;
        block.weight = weight;
        for (std::size_t i = 0; i < k; i++) {
            need(indices.data()[i] >= 0 && indices.data()[i] < problem_.p, "indices");
            block.indices.push_back(int(indices.data()[i]));
        }
        block.coefficients.assign(coefficients.data(), coefficients.data() + 16 * k);
        std::copy(constant.data(), constant.data() + 16, block.constant);
        block.spread.assign(spread.data(), spread.data() + spread.size());
        if (nominal_inverse.size() == 16) std::copy(nominal_inverse.data(), nominal_inverse.data() + 16, block.nominal_inverse);
        block.nominal_log_determinant = nominal_log_determinant;
        problem_.blocks.push_back(std::move(block));
    }

    // The cones of b - A x, A (rows, p and more) by rows: kind 0 nonnegative entries, 1 a positive semidefinite
    // triangle column by column with off-diagonals times sqrt(2), 2 a second-order cone as its arrow matrix.
    void read(Integers starts, Integers columns, Doubles values, Doubles b, Integers kinds, Integers orders, Integers first,
              Doubles weights) {
        for (std::size_t c = 0; c < kinds.size(); c++) {
            const int kind = int(kinds.data()[c]), order = int(orders.data()[c]);
            const std::size_t row = std::size_t(first.data()[c]);
            if (kind == 0) {
                for (int i = 0; i < order; i++) problem_.blocks.push_back(block(starts, columns, values, b, 1, 1, row + i));
                continue;
            }
            need(order >= 1 && order <= 4, "order");
            problem_.blocks.push_back(block(starts, columns, values, b, kind, order, row));
            problem_.blocks.back().weight = weights.data()[c];
        }
    }

    std::tuple<int, bool, double> solve(Doubles R, Doubles rho, double residual_norm, Doubles start, double warmth,
                                        double tolerance, int most, Out theta, Out multipliers) const {
        const Data data = seen(R, rho, residual_norm);
        need(start.size() == std::size_t(problem_.p) && theta.size() == start.size(), "theta");
        need(multipliers.size() == 16 * problem_.blocks.size(), "multipliers");
        nb::gil_scoped_release free;
        const Answer answer = InteriorPoint(problem_, data).solve(start.data(), warmth, tolerance, most);
        std::copy(answer.theta.begin(), answer.theta.end(), theta.data());
        std::copy(answer.multipliers.begin(), answer.multipliers.end(), multipliers.data());
        return {answer.iterations, answer.converged, answer.gap};
    }

    std::size_t blocks() const { return problem_.blocks.size(); }

    double lower_bound(Doubles R, Doubles rho, double residual_norm, Doubles theta, Doubles multipliers) const {
        const Data data = seen(R, rho, residual_norm);
        need(theta.size() == std::size_t(problem_.p) && multipliers.size() == 16 * problem_.blocks.size(), "theta");
        nb::gil_scoped_release free;
        return LowerBound(problem_, data).of(theta.data(), multipliers.data());
    }

    bool inside(Doubles theta) const {
        need(theta.size() == std::size_t(problem_.p), "theta");
        for (const Block& block : problem_.blocks)
            if (!safely_inside(block, theta.data())) return false;
        return true;
    }

    // The objective, infinite where a matrix under a logarithm is not positive definite.
    double value(Doubles R, Doubles rho, double residual_norm, Doubles theta) const {
        const Data data = seen(R, rho, residual_norm);
        need(theta.size() == std::size_t(problem_.p), "theta");
        double sum = residual_norm * residual_norm;
        for (int k = 0; k < data.rows; k++) {
            const double r = dot(data.row(k), theta.data(), problem_.p) - rho.data()[k];
            sum += r * r;
        }
        for (const Block& block : problem_.blocks) {
            if (block.weight == 0.0) continue;
            double P[16], L[16];
            block.value(theta.data(), P);
            if (!small::cholesky(P, L, block.d)) return HUGE_VAL;
            sum += block.weight * (small::inner(block.nominal_inverse, P, block.d) - small::log_determinant(L, block.d) +
                                   block.nominal_log_determinant - block.d);
        }
        return sum;
    }

private:
    Problem problem_;

    Block block(const Integers& starts, const Integers& columns, const Doubles& values, const Doubles& b, int kind, int order,
                std::size_t row) const {
        Block out;
        out.d = order;
        // Entry e of the vector, of value x, in a matrix.
        auto place = [&](int e, double x, double* M) {
            if (kind == 2) {
                if (e == 0)
                    for (int i = 0; i < order; i++) M[5 * i] += x;
                else
                    M[e] += x, M[4 * e] += x;
                return;
            }
            int j = 0;
            while ((j + 1) * (j + 2) / 2 <= e) j++;
            const int i = e - j * (j + 1) / 2;
            const double part = i == j ? x : x / std::sqrt(2.0);
            M[4 * i + j] += part;
            if (i != j) M[4 * j + i] += part;
        };
        const int rows = kind == 2 ? order : order * (order + 1) / 2;
        need(row + rows < starts.size() && row + rows <= b.size(), "rows");
        for (int e = 0; e < rows; e++) {
            place(e, b.data()[row + e], out.constant);
            for (auto k = starts.data()[row + e]; k < starts.data()[row + e + 1]; k++) {
                const int column = int(columns.data()[k]);
                need(column >= 0 && column < problem_.p, "column");
                std::size_t i = std::size_t(std::find(out.indices.begin(), out.indices.end(), column) - out.indices.begin());
                if (i == out.indices.size()) {
                    out.indices.push_back(column);
                    out.coefficients.resize(16 * (i + 1), 0.0);
                }
                place(e, -values.data()[k], &out.coefficients[16 * i]);
            }
        }
        return out;
    }

    Data seen(const Doubles& R, const Doubles& rho, double residual_norm) const {
        need(R.size() == rho.size() * std::size_t(problem_.p), "R");
        return Data(int(rho.size()), problem_.p, R.data(), rho.data(), residual_norm);
    }
};

}  // namespace

NB_MODULE(sdp_vs_penalty_native, m) {
    m.attr("__version__") = "0.1.0";
    nb::class_<Structured>(m, "Structured")
        .def(nb::init<Doubles, Doubles, std::uintptr_t, std::uintptr_t, std::uintptr_t>())
        .def("add", &Structured::add)
        .def("read", &Structured::read)
        .def_prop_ro("blocks", [](const Structured& s) { return s.blocks(); })
        .def("solve", &Structured::solve)
        .def("inside", &Structured::inside)
        .def("value", &Structured::value)
        .def("lower_bound", &Structured::lower_bound);
    m.def("regressor", [](Integers parents, Integers prismatic, Doubles rotations, Doubles translations, Doubles axes,
                          Doubles gravity, Doubles q, Doubles dq, Doubles ddq, Out out) {
        const int n = int(parents.size()), N = n ? int(q.size()) / n : 0;
        need(rotations.size() == std::size_t(9 * n) && translations.size() == std::size_t(3 * n), "placements");
        need(prismatic.size() == std::size_t(n) && axes.size() == std::size_t(3 * n) && gravity.size() == 3, "axes");
        need(dq.size() == q.size() && ddq.size() == q.size() && out.size() == std::size_t(N) * n * 10 * n, "states");
        for (int i = 0; i < n; i++) need(parents.data()[i] >= -1 && parents.data()[i] < i, "parents");
        nb::gil_scoped_release free;
        regressor(n, N, parents.data(), prismatic.data(), rotations.data(), translations.data(), axes.data(), gravity.data(), q.data(),
                  dq.data(), ddq.data(), out.data());
    });
    m.def("numbers", [](nb::bytes text, int width, Out out) {
        const char* begin = text.c_str();
        const char* end = begin + text.size();
        const std::size_t size = out.size();
        double* to = out.data();
        nb::gil_scoped_release free;
        return numbers(begin, end, width, to, size);
    });
}
