/*
 * Doubles.
 */

#ifndef KINPOLE_NUMBERS_H
#define KINPOLE_NUMBERS_H

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
dot(const double *a, const double *b, long long count)
{
    double sum = 0.0;
    for (long long k = 0; k < count; k++)
        sum += a[k] * b[k];
    return sum;
}

#endif
