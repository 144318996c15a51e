/* The double pendulum by hand, and loops that call a kernel through a pointer.

   The equations are those of the textbooks, solved for the accelerations (L. D. Landau, E. M. Lifshitz, Mechanics,
   section 5, problem 1, and Cramer's rule). Angles from the vertical; y = [theta1, theta2, v1, v2],
   p = [m1, m2, l1, l2, g]. A kernel has the signature of lagrange's. */

#include <math.h>
#include <stdint.h>

typedef int32_t kernel(double t, const double *y, const double *p, double *out);

int32_t by_hand(double t, const double *restrict y, const double *restrict p, double *restrict out)
{
    const double m1 = p[0], m2 = p[1], l1 = p[2], l2 = p[3], g = p[4];
    const double v1 = y[2], v2 = y[3];
    const double s = sin(y[0] - y[1]), c = cos(y[0] - y[1]);
    const double s1 = sin(y[0]), s2 = sin(y[1]);
    const double d = m1 + m2 * s * s;
    (void)t;
    out[0] = -(m2 * s * (l1 * v1 * v1 * c + l2 * v2 * v2) + g * ((m1 + m2) * s1 - m2 * s2 * c)) / (l1 * d);
    out[1] = (s * ((m1 + m2) * l1 * v1 * v1 + m2 * l2 * v2 * v2 * c) + (m1 + m2) * g * (s1 * c - s2)) / (l2 * d);
    return 0;
}

/* The same right-hand side as y' = [v, a], for the loop below. */
static inline void slope(const double *restrict y, const double *restrict p, double *restrict out)
{
    out[0] = y[2];
    out[1] = y[3];
    by_hand(0.0, y, p, out + 2);
}

/* Call the kernel for each of `count` states, `rounds` times over: calls may overlap in the processor. */
double independent(kernel *f, const double *p, const double *states, int64_t count, int64_t rounds)
{
    double total = 0.0, out[2];
    for (int64_t r = 0; r < rounds; r++)
        for (int64_t i = 0; i < count; i++) {
            if (f(0.0, states + 4 * i, p, out)) return NAN;
            total += out[0] + out[1];
        }
    return total;
}

/* The same, each state put off by a little of the last result, so that a call waits for the one before, as the stages of
   an integrator do. */
double chained(kernel *f, const double *p, const double *states, int64_t count, int64_t rounds)
{
    double total = 0.0, y[4], out[2] = {0.0, 0.0};
    for (int64_t r = 0; r < rounds; r++)
        for (int64_t i = 0; i < count; i++) {
            for (int k = 0; k < 4; k++) y[k] = states[4 * i + k] + 1e-20 * out[k & 1];
            if (f(0.0, y, p, out)) return NAN;
            total += out[0] + out[1];
        }
    return total;
}

/* The classical Runge-Kutta method with `steps` fixed steps, every state kept: rows[steps + 1][4]. */
void rk4(const double *p, double h, int64_t steps, double *restrict rows)
{
    double a[4], b[4], c[4], d[4], y[4];
    for (int64_t i = 0; i < steps; i++) {
        const double *now = rows + 4 * i;
        double *next = rows + 4 * (i + 1);
        slope(now, p, a);
        for (int k = 0; k < 4; k++) y[k] = now[k] + h / 2 * a[k];
        slope(y, p, b);
        for (int k = 0; k < 4; k++) y[k] = now[k] + h / 2 * b[k];
        slope(y, p, c);
        for (int k = 0; k < 4; k++) y[k] = now[k] + h * c[k];
        slope(y, p, d);
        for (int k = 0; k < 4; k++) next[k] = now[k] + h / 6 * (a[k] + 2 * b[k] + 2 * c[k] + d[k]);
    }
}
