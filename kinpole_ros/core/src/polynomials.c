#include <math.h>

#include "polynomials.h"
#include "numbers.h"

PRIVATE void
make_polynomials(double *rows, long long n, double first, Polynomials *p)
{
    for (int k = 0; k < p->count; k++) {
        double *own = rows + k * n;
        for (long long t = 0; k && t < n; t++)
            own[t] = own[t - n] * (first + t) / n;
        for (int l = 0; l < k; l++) {
            const double *other = rows + l * n;
            p->factor[l][k] = dot(own, other, n);
            for (long long t = 0; t < n; t++)
                own[t] -= p->factor[l][k] * other[t];
        }
        p->factor[k][k] = sqrt(dot(own, own, n));
        for (long long t = 0; t < n; t++)
            own[t] = k < p->length ? own[t] / p->factor[k][k] : 0.0;
    }
}

PRIVATE void
fit_polynomials(const double *rows, long long n, double *signal, int signals, Polynomials *p)
{
    for (int c = 0; c < signals; c++, signal += n) {
        for (int k = 0; k < p->count; k++) {
            p->along[k][c] = dot(signal, rows + k * n, n);
            for (long long t = 0; t < n; t++)
                signal[t] -= p->along[k][c] * rows[k * n + t];
        }
        p->left[c] = dot(signal, signal, n);
    }
}

PRIVATE void
differentiate_polynomials(const Polynomials *p, long long n, long long orders,
                          double out[][MAX_POLYNOMIALS])
{
    for (int o = 0; o < orders; o++)
        for (int k = 0; k < p->count; k++) {
            double own = k ? (o ? o * out[o - 1][k - 1] / n : 0.0) : o == 0;
            for (int l = 0; l < k; l++)
                own -= p->factor[l][k] * out[o][l];
            out[o][k] = k < p->length ? own / p->factor[k][k] : 0.0;
        }
}
