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

/* Polynomials, `count` of them, on `length` samples that are not missing; `factor` is triangular.
   `along` are the coefficients of the signals, and `left` is what is left of their squares. */
typedef struct {
    int count;
    double length, factor[MAX_POLYNOMIALS][MAX_POLYNOMIALS];
    double along[MAX_POLYNOMIALS][MAX_SIGNALS], left[MAX_SIGNALS];
} Polynomials;

/* Make polynomials, whose `length` and `count` are given, at `rows` (count, n). Time is that since
   the instant, `first` samples at the first one, over the number n of samples. The first row are
   the roots of the weights of the samples. */
PRIVATE void make_polynomials(double *rows, long long n, double first, Polynomials *p);

/* Fit polynomials to signals (signals, n), times the roots of the weights, and leave what is
   left. */
PRIVATE void fit_polynomials(const double *rows, long long n, double *signal, int signals,
                             Polynomials *p);

/* Find the derivatives (orders, MAX_POLYNOMIALS) of the polynomials at the instant. */
PRIVATE void differentiate_polynomials(const Polynomials *p, long long n, long long orders,
                                       double out[][MAX_POLYNOMIALS]);

#endif
