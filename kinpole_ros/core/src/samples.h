/*
 * The samples of a window: three signals with weights, by angle and position.
 */

#ifndef KINPOLE_SAMPLES_H
#define KINPOLE_SAMPLES_H

#include "../include/call.h"
#include "private.h"

/* The samples of a signal, `count` of angle and both coordinates, in deviations of their noise;
   their weights, 0 to 1, by angle and position; and by how many samples each is after its place. */
typedef struct {
    long long count;
    double *x[3], *weight[2], *off;
} Samples;

/* Lay out `count` samples of zeros in memory for this purpose, of memory.h; returns 0 if there is
   none. */
PRIVATE int lay_out_samples(Call *call, int which, long long count, Samples *s);

/* Divide the samples of angle and position by the numbers `by` (2), as their noise. */
PRIVATE void divide_samples(const Samples *s, const double *by);

/* Return the largest size of a sample of the angle (c = 0), or of a coordinate (c = 1). */
PRIVATE double largest_sample(const Samples *s, int c);

/* Return the mean of the numbers that are at least SIMILAR_INFORMATION times the largest. */
PRIVATE double mean_of_similar(const double *information, long long count);

/* Divide information by the usual one, in place; weights of similar information are 1. */
PRIVATE void normalize_weights(double *weight, long long count, double usual);

/* Put missing samples on parabolas through the nearest of the others; of two equally near ones, the
   older is the first. */
PRIVATE void fill_missing(const Samples *s);

/* Move samples to the even grid by parabolas through their neighbors, into `moved` (3, count). */
PRIVATE void move_by_neighbors(const Samples *s, double *const moved[3]);

#endif
