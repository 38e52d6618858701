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

/* The larger of a and b; b if either is NaN. */
static inline double
larger(double a, double b)
{
    return a > b ? a : b;
}

/* The smaller of a and b; b if either is NaN. */
static inline double
smaller(double a, double b)
{
    return a < b ? a : b;
}

/* The squared absolute value of z. */
static inline double
square_of(Number z)
{
    return creal(z) * creal(z) + cimag(z) * cimag(z);
}

/* The sum of the products of a and b (count). Four sums at once, so that the processor need not
   wait for each addition. */
static inline double
dot(const double *a, const double *b, long long count)
{
    double sum[4] = {0.0};
    long long k = 0;
    for (; k + 4 <= count; k += 4)
        for (int i = 0; i < 4; i++)
            sum[i] += a[k + i] * b[k + i];
    for (; k < count; k++)
        sum[0] += a[k] * b[k];
    return sum[0] + sum[1] + (sum[2] + sum[3]);
}

#endif
