/*
 * Screening of steps at all places of a window, by one model.
 */

#ifndef KINPOLE_SCREENS_H
#define KINPOLE_SCREENS_H

#include "models.h"

/* What one model with the samples of low weight of a set leaves of the angle (c = 0), or of the
   position (c = 1). P is that of the model less the sum of factor r r' of the reduced columns r. */
typedef struct {
    int c;
    long long model;
    double residual_squares;  /* x' P x */
    double *residual;         /* (c + 1, count): P x */
    double *step_products;    /* (c + 1, STEP_ORDERS, count): b' P x */
    double *squared_products; /* (STEP_ORDERS, count): their squares, summed over coordinates */
    double *step_squares;     /* (STEP_ORDERS, count): b' P b, infinite if nothing is left of b */
    double *reduced_columns;  /* (low_samples, count): P b with the P before, b one sample */
    double *factor;           /* (low_samples) */
} Screen;

/* The screens of angle and position. */
typedef struct {
    Screen signal[2];
    double *gain; /* (STEP_ORDERS, count): the squares that a step explains, over twice the
                     variance of the noise, about the log evidence that it adds, without its cost */
    double *sample_weights; /* (2, orders, count): minus those of the samples in the
                               derivatives at the instant: `find_sample_weights` */
} Screens;

/* An event half a sample before `sample`, and its gain. */
typedef struct {
    double gain;
    long long sample;
    int order;
} Candidate;

/* Compute the `residual` P x (count) that a model, by its number, leaves of a `signal` x (count),
   which may be the same memory, with these `coefficients` (rows). `sums` (half) is memory. */
PRIVATE void subtract_model(const Models *m, long long model, const double *coefficients,
                            const double *signal, Lanes *sums, double *residual);

/* Compute the products `sums` (STEP_ORDERS, count) of a `signal` (count) with steps half a
   sample before each one. Those with (t + 1/2)^k / k! follow from repeated cumulative sums, in
   one pass. */
PRIVATE void sum_products_with_steps(const double *signal, long long count, double *sums);

/* Return how many samples there are at least between an event of this order and the ends of a
   window, so that both sides show it. */
PRIVATE long long edge_of(int order);

/* Lay out the arrays of screens at `data`, for `count` samples, `low` of them of low weight, and so
   many orders; returns the end of their memory. */
PRIVATE char * lay_out_screens(long long count, long long orders, long long low, char *data,
                               Screens *screens);

/* Screen steps of all orders at all places of a window, with the most probable models of the set
   without events, and return the best, with a gain of -infinity if the window is too short for any.
   `screens` is laid out. */
PRIVATE Candidate screen_window(const Models *m, const Samples *s, const Work *w, const Set *set,
                                Screens *screens);

#endif
