/* Calls of a right-hand side through a pointer, each at a state that waits for the slopes before, as the stages of an
   integrator do. A kernel has the signature of lagrange's; `size` is that of a state. */

#include <stdint.h>

enum { LARGEST = 256 };

typedef int32_t kernel(double t, const double *y, const double *p, double *out);

int32_t waiting(kernel *f, const double *p, const double *start, int64_t size, int64_t count)
{
    double y[LARGEST], slope[LARGEST];
    int32_t failed = size > LARGEST;
    if (failed) return failed;
    for (int64_t k = 0; k < size; k++) y[k] = start[k];
    for (int64_t i = 0; i < count; i++) {
        failed |= f(0.0, y, p, slope);
        for (int64_t k = 0; k < size; k++) y[k] += 1e-20 * slope[k];
    }
    return failed;
}
