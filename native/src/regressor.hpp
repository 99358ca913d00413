// tau = Y theta of a tree of rigid links (Atkeson, An, Hollerbach, IJRR 1986), eight samples at a time.
#pragma once
#include <cmath>
#include <cstdint>
#include <cstring>
#include <vector>

namespace lanes {

constexpr int WIDTH = 8;
typedef double Lane __attribute__((vector_size(8 * WIDTH)));

struct Vector {
    Lane x, y, z;
};

inline Vector operator+(const Vector& a, const Vector& b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
inline Vector operator*(const Vector& a, const Lane& s) { return {a.x * s, a.y * s, a.z * s}; }
inline Vector cross(const Vector& a, const Vector& b) {
    return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}
inline Lane dot(const Vector& a, const Vector& b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
inline Vector constant(const double* v) {
    const Lane zero = {};
    return {zero + v[0], zero + v[1], zero + v[2]};
}
// R^T u for R (3, 3) row by row.
inline Vector back(const double* R, const Vector& u) {
    return {R[0] * u.x + R[3] * u.y + R[6] * u.z, R[1] * u.x + R[4] * u.y + R[7] * u.z, R[2] * u.x + R[5] * u.y + R[8] * u.z};
}

}  // namespace lanes

struct Link {
    lanes::Vector omega, alpha, acceleration;  // of the joint frame, in its own axes, gravity taken away
    std::vector<lanes::Vector> axis, arm;      // of every joint: its axis, and from its origin to this one
};

// parents (n,), -1 the base; rotations (n, 3, 3), translations (n, 3): joint frame in its parent's at q = 0, turned
// so that axes (n, 3) in ``axes`` are in the joint frame. states (N, n); out (N, n, 10 n).
inline void regressor(int n, int N, const std::int64_t* parents, const std::int64_t* prismatic, const double* rotations,
                      const double* translations, const double* axes, const double* gravity, const double* q,
                      const double* dq, const double* ddq, double* out) {
    using namespace lanes;
    std::memset(out, 0, sizeof(double) * std::size_t(N) * n * 10 * n);
    std::vector<Link> links(n, Link{{}, {}, {}, std::vector<Vector>(n), std::vector<Vector>(n)});
    const Vector none = {};
    const double up[3] = {-gravity[0], -gravity[1], -gravity[2]};
    for (int first = 0; first < N; first += WIDTH) {
        const int here = std::min(WIDTH, N - first);
        for (int i = 0; i < n; i++) {
            Lane sine, cosine, position, speed, rise;
            for (int b = 0; b < WIDTH; b++) {
                const std::size_t k = std::size_t(first + std::min(b, here - 1)) * n + i;
                position[b] = q[k];
                sine[b] = prismatic[i] ? 0.0 : std::sin(q[k]);
                cosine[b] = prismatic[i] ? 1.0 : std::cos(q[k]);
                speed[b] = dq[k];
                rise[b] = ddq[k];
            }
            const double* R = rotations + 9 * i;
            const Vector s = constant(axes + 3 * i);
            Vector p = constant(translations + 3 * i);
            if (prismatic[i]) {
                const double* a = axes + 3 * i;
                const double along[3] = {R[0] * a[0] + R[1] * a[1] + R[2] * a[2], R[3] * a[0] + R[4] * a[1] + R[5] * a[2],
                                         R[6] * a[0] + R[7] * a[1] + R[8] * a[2]};
                p = p + constant(along) * position;
            }
            // Into the joint frame: by its placement, then turned back by q about the axis (Rodrigues).
            auto inward = [&](const Vector& u) {
                const Vector v = back(R, u);
                const Lane along = dot(s, v) * (1.0 - cosine);
                const Vector side = cross(s, v);
                return Vector{cosine * v.x + along * s.x - sine * side.x, cosine * v.y + along * s.y - sine * side.y,
                              cosine * v.z + along * s.z - sine * side.z};
            };
            Link& link = links[i];
            const int parent = int(parents[i]);
            const Vector omega0 = parent < 0 ? none : links[parent].omega, alpha0 = parent < 0 ? none : links[parent].alpha;
            const Vector lift = parent < 0 ? constant(up) : links[parent].acceleration;
            const Vector carried = inward(omega0);
            link.acceleration = inward(lift + cross(alpha0, p) + cross(omega0, cross(omega0, p)));
            link.omega = carried;
            link.alpha = inward(alpha0);
            if (prismatic[i]) {
                link.acceleration = link.acceleration + s * rise + cross(carried, s * (2.0 * speed));
            } else {
                link.omega = carried + s * speed;
                link.alpha = link.alpha + cross(carried, s * speed) + s * rise;
            }
            for (int j = parent; j >= 0; j = int(parents[j])) {
                link.axis[j] = inward(links[parent].axis[j]);
                link.arm[j] = inward(links[parent].arm[j] + p);
            }
            link.axis[i] = s;
            link.arm[i] = none;
            const Vector &w = link.omega, &e = link.alpha, &a = link.acceleration;
            // force = m a + M (m c) with M = [alpha] + [omega]^2
            const Lane xx = w.x * w.x, yy = w.y * w.y, zz = w.z * w.z, xy = w.x * w.y, xz = w.x * w.z, yz = w.y * w.z;
            const Vector c0 = {-(yy + zz), xy + e.z, xz - e.y}, c1 = {xy - e.z, -(xx + zz), yz + e.x},
                         c2 = {xz + e.y, yz - e.x, -(xx + yy)};
            for (int j = i; j >= 0; j = int(parents[j])) {
                const Vector z = prismatic[j] ? none : link.axis[j];
                const Vector u = prismatic[j] ? link.axis[j] : cross(link.axis[j], link.arm[j]);
                const Vector turn = cross(z, w), side = cross(a, z);
                const Lane row[10] = {dot(u, a),
                                      dot(u, c0) + side.x,
                                      dot(u, c1) + side.y,
                                      dot(u, c2) + side.z,
                                      z.x * e.x + turn.x * w.x,
                                      z.x * e.y + z.y * e.x + turn.x * w.y + turn.y * w.x,
                                      z.y * e.y + turn.y * w.y,
                                      z.x * e.z + z.z * e.x + turn.x * w.z + turn.z * w.x,
                                      z.y * e.z + z.z * e.y + turn.y * w.z + turn.z * w.y,
                                      z.z * e.z + turn.z * w.z};
                for (int b = 0; b < here; b++) {
                    double* to = out + ((std::size_t(first + b) * n + j) * n + i) * 10;
                    for (int c = 0; c < 10; c++) to[c] = row[c][b];
                }
            }
        }
    }
}
