/* Joint torques of $robot, identified by $method; written by sdp-vs-penalty.

   void @_torque(q, dq, ddq, tau): joints in order $joints, in rad or m, N m or N.
   tau = M(q) ddq + C(q, dq) dq + g(q), by recursive Newton-Euler (Luh, Walker, Paul 1980), and a formula an effect
   at its end. C99, no library but libm.
   Not in this file: $left. */
#ifndef @_H
#define @_H
#include <math.h>
#define @_N $n

/* out = sign * a x b, added to what is there */
static inline void @_cross(double sign, const double a[3], const double b[3], double out[3]) {
  for (int k = 0; k < 3; k++)
    out[k] += sign * (a[(k + 1) % 3] * b[(k + 2) % 3] - a[(k + 2) % 3] * b[(k + 1) % 3]);
}

/* out = A b, or A' b, added to what is there; A: nine numbers, row by row */
static inline void @_times(const double *A, int transposed, const double b[3], double out[3]) {
  for (int i = 0; i < 3; i++)
    for (int j = 0; j < 3; j++) out[i] += A[transposed ? 3 * j + i : 3 * i + j] * b[j];
}

/* torque that links need on each joint, from each link's mass, first moments and inertia about its joint's frame */
static inline void @_links(const double q[], const double dq[], const double ddq[], const double mass[],
                           const double first[][3], const double inertia[][3][3], double load[]) {
  /* the joint before, and 1 for a prismatic joint */
  static const int parent[@_N] = $parent, slides[@_N] = $slides;
  /* of each joint's frame in its parent's: origin and orientation; the axis in its own */
  static const double origin[@_N][3] = $origin;
  static const double turned[@_N][3][3] = $turned;
  static const double axis[@_N][3] = $axis;
  /* angular velocity and acceleration, acceleration less gravity, force, moment; [N]: the base */
  double w[@_N + 1][3] = {{0}}, u[@_N + 1][3] = {{0}}, a[@_N + 1][3] = {{0}};
  double f[@_N + 1][3] = {{0}}, m[@_N + 1][3] = {{0}}, R[@_N][3][3] = {{{0}}}, r[@_N][3];
  const double up[3] = $up;
  for (int k = 0; k < 3; k++) a[@_N][k] = up[k];
  for (int i = 0; i < @_N; i++) {
    const int p = parent[i];
    const double *s = axis[i], c = slides[i] ? 1.0 : cos(q[i]), z = slides[i] ? 0.0 : sin(q[i]);
    double carried[3], spun[3] = {0}, push[3], inner[3] = {0};
    for (int k = 0; k < 3; k++) { /* R = turned Rodrigues(axis, q), r = origin + turned axis q */
      double e[3] = {0}, rotated[3] = {0};
      e[k] = 1.0;
      @_cross(z, s, e, rotated);
      for (int l = 0; l < 3; l++) rotated[l] += c * e[l] + (1.0 - c) * s[k] * s[l];
      for (int j = 0; j < 3; j++)
        for (int l = 0; l < 3; l++) R[i][j][k] += turned[i][j][l] * rotated[l];
      r[i][k] = origin[i][k];
      for (int l = 0; l < 3; l++) r[i][k] += slides[i] ? turned[i][k][l] * s[l] * q[i] : 0.0;
    }
    for (int k = 0; k < 3; k++) carried[k] = a[p][k], push[k] = dq[i] * s[k];
    @_cross(1.0, u[p], r[i], carried);
    @_cross(1.0, w[p], r[i], inner);
    @_cross(1.0, w[p], inner, carried);
    @_times(&R[i][0][0], 1, carried, a[i]);
    @_times(&R[i][0][0], 1, w[p], w[i]);
    @_times(&R[i][0][0], 1, u[p], u[i]);
    @_cross(slides[i] ? 2.0 : 1.0, w[i], push, slides[i] ? a[i] : u[i]);
    for (int k = 0; k < 3; k++) {
      (slides[i] ? a[i] : u[i])[k] += ddq[i] * s[k];
      w[i][k] += slides[i] ? 0.0 : push[k];
      f[i][k] = mass[i] * a[i][k];
    }
    double swung[3] = {0};
    @_cross(1.0, w[i], first[i], swung); /* f = m a + u x mc + w x (w x mc) */
    @_cross(1.0, u[i], first[i], f[i]);
    @_cross(1.0, w[i], swung, f[i]);
    @_times(&inertia[i][0][0], 0, w[i], spun); /* m = I u + w x I w + mc x a */
    @_times(&inertia[i][0][0], 0, u[i], m[i]);
    @_cross(1.0, w[i], spun, m[i]);
    @_cross(1.0, first[i], a[i], m[i]);
  }
  for (int i = @_N - 1; i >= 0; i--) {
    double handed[3] = {0};
    load[i] = 0.0;
    for (int k = 0; k < 3; k++) load[i] += axis[i][k] * (slides[i] ? f[i] : m[i])[k];
    @_times(&R[i][0][0], 0, f[i], handed);
    for (int k = 0; k < 3; k++) f[parent[i]][k] += handed[k];
    @_times(&R[i][0][0], 0, m[i], m[parent[i]]);
    @_cross(1.0, r[i], handed, m[parent[i]]);
  }
}

static inline void @_torque(const double q[], const double dq[], const double ddq[], double tau[]) {
  /* of each link about its joint's frame: mass, first moments, inertia */
  static const double mass[@_N] = $mass;
  static const double first[@_N][3] = $first;
  static const double inertia[@_N][3][3] = $inertia;
  double load[@_N]; /* torque of the links on each joint */
  @_links(q, dq, ddq, mass, first, inertia, load);
  for (int i = 0; i < @_N; i++) tau[i] = load[i];
$formulas
}
#endif
