/*
 * Screening of steps at all places of a window, by one model.
 */

#ifndef KINPOLE_SCREENS_H
#define KINPOLE_SCREENS_H

#include "models.h"

/* Samples between an event and the ends of the window, so that both sides are seen. */
#define EDGE_SAMPLES 3
/* So many more beside a step of acceleration: it explains whatever three samples show, also a step
   of velocity. Without them the jerk at events has four times the error. */
#define MORE_EDGE_SAMPLES 2
/* A step of which the columns leave less than this share is already in the set. */
#define MIN_STEP_LEFT 1e-6

/* What one model with the columns of a set leaves of the angle (c = 0), or of the position (c = 1).
   P is that of the model less the sum of factor r r' of the reduced columns r. */
typedef struct {
    int c;
    long long model, columns;
    double residual_squares;  /* x' P x */
    double *residual;         /* (c + 1, count): P x */
    double *step_products;    /* (c + 1, STEP_ORDERS, count): b' P x */
    double *squared_products; /* (STEP_ORDERS, count): their squares, summed over coordinates */
    double *step_squares;     /* (STEP_ORDERS, count): b' P b, infinite if it is rounding */
    double *reduced_columns;  /* (columns, count): P b with the P before this column */
    double *factor;           /* (columns) */
} Screen;

/* The screens of angle and position. */
typedef struct {
    Screen signal[2];
    double *gain; /* (STEP_ORDERS, count): log evidence that a step adds, without its cost */
    double *sample_weights; /* (2, orders, count): minus those of the samples in the
                               derivatives at the instant: `find_sample_weights` */
} Screens;

/* An event half a sample before `sample`, and the log evidence that it adds. */
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

/* Return by how much the step `k`, order times count plus its place, reduces the residual sum of
   squares, if the prior variance of its size is the square of the estimate. Writes `ratio`, that
   square over the variance of the estimate. */
PRIVATE double explained_squares(const Screen *screen, long long k, double *ratio);

/* Lay out the arrays of screens at `data`, for `count` samples, so many orders and so many columns
   of each; returns the end of their memory. */
PRIVATE char * lay_out_screens(long long count, long long orders, long long columns, char *data,
                               Screens *screens);

/* Screen steps of all orders at all places of a window, with the most probable models of the set
   without events, and return the best. The gain of a place is without the cost of the size, and has
   the approximation z (6 - z) / (6 - 4 z) of -log(1 - z), because there are many places. `screens`
   is laid out; `scratch` (count) is memory. */
PRIVATE Candidate screen_window(const Models *m, const Samples *s, const Work *w, const Set *set,
                                double *scratch, Screens *screens);

#endif
