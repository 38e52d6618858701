/*
 * The samples of a window: three signals with weights, by angle and position.
 *
 * In all files of the estimator signal c = 0 is the angle, and c = 1 and 2 are the coordinates of
 * the position. Arrays of 2 are by angle and position. Times are in samples, or in cells where a
 * sample may be the mean of several. Signals are in deviations of their noise unless a comment says
 * otherwise, and so are derivatives, per sample to the power of their order.
 */

#ifndef KINPOLE_SAMPLES_H
#define KINPOLE_SAMPLES_H

#include "../include/call.h"
#include "private.h"

/* The samples of a body in a window, the oldest first. All arrays have `count` elements. */
typedef struct {
    long long count;
    double *x[3];      /* the signals */
    double *weight[2]; /* 0 to 1: 1 / variance of the noise; both are 0 for a missing sample */
    double *off;       /* samples by which each is after its place on the even grid */
} Samples;

/* Lay out `count` samples of zeros in memory for the purpose `which` of memory.h: one array after
   the other, in their order in the struct. Returns 1, or 0 if there is no memory. */
PRIVATE int lay_out_samples(Call *call, int which, long long count, Samples *s);

/* Divide the signals of angle and position by the numbers `noise` (2). Weights stay. */
PRIVATE void divide_samples(const Samples *s, const double *noise);

/* Return the largest size of a sample of the angle (c = 0), or of either coordinate (c = 1). */
PRIVATE double largest_sample(const Samples *s, int c);

/* Return the mean of `information` (count) that is at least SIMILAR_INFORMATION times the
   largest. */
PRIVATE double mean_of_similar(const double *information, long long count);

/* Divide information (count) by the usual one, in place; similar information becomes a weight of 1.
   All weights are 0 if the usual one is not above 0. */
PRIVATE void normalize_weights(double *weight, long long count, double usual);

/* Put missing samples on parabolas through the nearest PARABOLA_SAMPLES of the others, by least
   squares; of two equally near ones, the older is the first. At least 3 samples are not missing. */
PRIVATE void fill_missing(const Samples *s);

/* Move samples, none of them missing, to the even grid by parabolas through their neighbors. Writes
   `moved` (3, count). */
PRIVATE void move_by_neighbors(const Samples *s, double *const moved[3]);

#endif
