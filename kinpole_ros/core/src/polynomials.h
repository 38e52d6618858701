/*
 * Polynomials that are orthonormal on consecutive samples, and their derivatives at an instant.
 *
 * Each is the one before it times time, made orthogonal to all before it (Brubeck and others,
 * Vandermonde with Arnoldi, 2021), so they stay so where powers of time are all but parallel.
 */

#ifndef KINPOLE_POLYNOMIALS_H
#define KINPOLE_POLYNOMIALS_H

#include "models.h"

/* The covariance is that of a polynomial so many degrees higher, because the samples do not show
   what is below their noise. */
#define MORE_DEGREES 2
/* Log evidence that a coefficient costs, about the logarithm of how far it exceeds its noise. */
#define COEFFICIENT_COST 5.0
/* Polynomials and signals that are fitted at most. */
#define MAX_POLYNOMIALS 7
#define MAX_SIGNALS 4

/* Polynomials of the degrees from 0 on. */
typedef struct {
    int count;     /* polynomials */
    double length; /* samples that are not missing; of more polynomials the higher ones are 0 */
    /* (l, k): what time times polynomial k - 1 has along polynomial l < k; (k, k): the length of
       the rest. */
    double factor[MAX_POLYNOMIALS][MAX_POLYNOMIALS];
    double along[MAX_POLYNOMIALS][MAX_SIGNALS]; /* coefficients of the signals */
    double left[MAX_SIGNALS]; /* sums of squares of what the polynomials leave of the signals */
} Polynomials;

/* Make the polynomials `rows` (count, n) at n samples, times the roots of the weights of these,
   which are given in the first row. `count` and `length` of `p` are given; writes its `factor`.
   Time is that since the instant, over n; it is `first` samples at the first one. */
PRIVATE void make_polynomials(double *rows, long long n, double first, Polynomials *p);

/* Fit the polynomials `rows` (count, n) to `signal` (signals, n), which has the same factors.
   Writes `along` and `left` of `p`, and leaves in `signal` what the polynomials do not explain. */
PRIVATE void fit_polynomials(const double *rows, long long n, double *signal, int signals,
                             Polynomials *p);

/* Find the derivatives `out` (orders, MAX_POLYNOMIALS) of the polynomials at the instant, per
   sample to the power of their order, from `factor` of those on n samples. */
PRIVATE void differentiate_polynomials(const Polynomials *p, long long n, long long orders,
                                       double out[][MAX_POLYNOMIALS]);

#endif
