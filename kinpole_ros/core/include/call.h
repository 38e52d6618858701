/*
 * The arguments and the return values of `kinpole_derive`.
 */

#ifndef KINPOLE_CALL_H
#define KINPOLE_CALL_H

#include "codes.h"
#include "structs.h"

/* Arrays that _models.py makes once for a kind of window, of `count` samples, each the mean of
   `block` frames. `orders` says which: 0 is `models_of`, -1 `slopes_of`, and any other number is
   `stencils_of` for the instant `at`, in samples from the middle. `exact` is 1 if the motion is so
   much larger than the noise that rounding matters. */
#define TABLE_FIELDS(VALUE, BLOCK, ARRAY) \
    VALUE(long long, count)               \
    VALUE(long long, block)               \
    VALUE(long long, exact)               \
    VALUE(long long, orders)              \
    VALUE(double, at)                     \
    ARRAY(const long long, integers)      \
    ARRAY(const double, numbers)

typedef STRUCT(TABLE_FIELDS) Table;

/* The arguments of `derive_poses` in _pose_derivatives.py, which describes the arrays (N, B) of B
   bodies in N frames, and (T, B) of T instants. Signals (T B) before `next` are done. The length
   `window` is in s; `flat` is the log standard deviation of the prior of mean and slope, over that
   of the noise. `time` (N) is in ns, and `windows` (3, T) are the frame of an instant, the oldest,
   and the newest of its window. See `write_results` for the results. `lacking` is the table to make
   before the next call. `workspace` is memory that C keeps for the next call: see memory.c. */
typedef struct Workspace Workspace;
#define CALL_FIELDS(VALUE, BLOCK, ARRAY)       \
    VALUE(long long, frames)                   \
    VALUE(long long, bodies)                   \
    VALUE(long long, instants)                 \
    VALUE(long long, next)                     \
    VALUE(long long, orders)                   \
    VALUE(long long, table_count)              \
    VALUE(double, window)                      \
    VALUE(double, flat)                        \
    ARRAY(const long long, time)               \
    ARRAY(const long long, windows)            \
    ARRAY(const long long, left_out)           \
    ARRAY(const double, angle)                 \
    ARRAY(const double, turns)                 \
    ARRAY(const double, position)              \
    ARRAY(const double, angle_information)     \
    ARRAY(const double, position_information)  \
    ARRAY(const double, noise)                 \
    ARRAY(const Table, tables)                 \
    ARRAY(double, results)                     \
    ARRAY(Workspace, workspace)                \
    VALUE(Table, lacking)

typedef STRUCT(CALL_FIELDS) Call;

/* Returns DONE, LACKING if `lacking` has to be made before another call, or an error below 0. */
API int kinpole_derive(Call *call);
/* Frees the memory that a call has used; it may be used again. */
API void kinpole_free_workspace(Call *call);

#endif
