/*
 * Doubles and complex numbers.
 */

#ifndef KINPOLE_NUMBERS_H
#define KINPOLE_NUMBERS_H

#include "../include/structs.h"

/* A whole turn, rad. */
#define TURN 6.283185307179586
/* A second, ns. */
#define SECOND 1000000000ll

static inline double
larger(double a, double b)
{
    return a > b ? a : b;
}

static inline double
smaller(double a, double b)
{
    return a < b ? a : b;
}

static inline double
square_of(Number z)
{
    return creal(z) * creal(z) + cimag(z) * cimag(z);
}

static inline double
dot(const double *a, const double *b, long long count)
{
    double sum = 0.0;
    for (long long k = 0; k < count; k++)
        sum += a[k] * b[k];
    return sum;
}

#endif
