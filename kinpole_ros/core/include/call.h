/*
 * The arguments and the return values of `kinpole_derive`.
 *
 * Shapes have B bodies, N frames, T instants, and K derivatives, from order 0 on. Covariances are
 * between derivatives of order k and l.
 */

#ifndef KINPOLE_CALL_H
#define KINPOLE_CALL_H

#include "codes.h"

/* Arrays that _models.py makes once for a kind of window: those of `models_of`, `slopes_of` or
   `stencils_of`. */
#define TABLE_FIELDS(VALUE, BLOCK, ARRAY)                                           \
    VALUE(long long, count, "samples of the window")                                \
    VALUE(long long, block, "frames of which a sample is the mean")                 \
    VALUE(long long, exact, "1 if rounding matters, in motion far above the noise") \
    VALUE(long long, orders, "TABLE_ORDERS, or K for stencils")                     \
    VALUE(long long, spectrum_number, "of the `spectrum` of a body; 0 for none")    \
    VALUE(double, from_middle, "samples: instant of stencils, after the middle")    \
    ARRAY(const long long, integers, "(I)", "sizes and indices: see models.h")      \
    ARRAY(const double, numbers, "(M)", "values of the models: see models.h")

typedef STRUCT(TABLE_FIELDS) Table;

/* Derivatives of poses; NaN with too few poses. */
#define DERIVATIVE_ARRAYS_FIELDS(VALUE, BLOCK, ARRAY)                                        \
    ARRAY(Number, position, "(K, T, B)", "m/s^k: derivatives of the position")               \
    ARRAY(double, angle, "(K, T, B)", "rad/s^k: derivatives of the angle")                   \
    ARRAY(double, position_covariance, "(K, K, T, B)", "m^2/s^(k + l): of one coordinate")   \
    ARRAY(double, angle_covariance, "(K, K, T, B)", "rad^2/s^(k + l): of the angle")         \
    ARRAY(double, span, "(T, B)", "s: length of the window")                                 \
    ARRAY(double, parameters, "(T, B)", "effective parameters of the angle; 2 if it is steady") \
    ARRAY(Number, reference, "(T, B)", "m: this point less the given one, in the body frame")

typedef STRUCT(DERIVATIVE_ARRAYS_FIELDS) DerivativeArrays;

/* The poses of a window, and the results: see `derive_poses` of _pose_derivatives.py. */
typedef struct Workspace Workspace;
/* Makes a table: writes `integers` and `numbers` of one that has all other fields. It may add the
   table to `tables` of the call. Returns DONE or NO_TABLE. */
typedef int (*TableMaker)(Table *table);
#define CALL_FIELDS(VALUE, BLOCK, ARRAY)                                                          \
    VALUE(long long, frames, "N")                                                                 \
    VALUE(long long, bodies, "B")                                                                 \
    VALUE(long long, instants, "T")                                                               \
    VALUE(long long, orders, "K")                                                                 \
    VALUE(long long, table_count, "number of tables")                                             \
    VALUE(double, window, "s: length of a full window")                                           \
    ARRAY(const long long, time, "(N)", "ns: when each frame was, by the clock")                  \
    ARRAY(const long long, windows, "(3, T)", "frames of the instant, the oldest, the newest")    \
    ARRAY(const long long, left_out, "(T, B)", "newest frames that are not used")                 \
    ARRAY(const double, angle, "(N, B)", "rad: angle of the body")                                \
    ARRAY(const double, turns, "(N, B)", "whole turns to add to the angle")                       \
    ARRAY(const Number, position, "(N, B)", "m: position of the given point of the body")         \
    ARRAY(const double, angle_information, "(N, B)", "squared noise over variance; 0 if unknown") \
    ARRAY(const double, position_information, "(N, B)", "the same, of a coordinate")              \
    ARRAY(const double, noise, "(T, B)", "m: standard deviation at an information of 1")          \
    ARRAY(const long long, spectrum, "(B)", "number of the spectrum of each body; 0 for none")    \
    ARRAY(const Table, tables, "(tables)", "the tables that are made")                            \
    VALUE(DerivativeArrays, derivatives, "the results")                                           \
    ARRAY(Workspace, workspace, "(1)", "memory that C keeps for the next call: see memory.h")     \
    VALUE(TableMaker, make_table, "makes a table that is not among them")

typedef STRUCT(CALL_FIELDS) Call;

/* Computes the results of all bodies at all instants, a signal each. Changes the arrays of
   `derivatives`, `workspace`, and what `make_table` changes. Returns DONE, or an error below 0. */
API int kinpole_derive(Call *call);
/* Frees the workspace; a later call makes another. */
API void kinpole_free_workspace(Call *call);

#endif
