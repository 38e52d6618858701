/* The arguments and the return values of `kinpole_derive`, which tracking/_follow.c calls too. */

/* Arrays that _models.py makes once for a kind of window, of `count` samples, each the mean of
   `block` frames. `orders` says which: 0 is `models_of`, -1 `slopes_of`, and any other number is
   `stencils_of` for the instant `at`, in samples from the middle. `exact` is 1 if the motion is so
   much larger than the noise that rounding matters. */
typedef struct {
    long long count, block, exact, orders;
    double at;
    const long long *integers;
    const double *numbers;
} Table;

/* The arguments of `derive_poses` in _poses.py, which describes the arrays (N, B) of B bodies in N
   frames, and (T, B) of T instants. */
typedef struct {
    long long frames, bodies, instants;
    long long next; /* signals (T B) before this one are done */
    long long orders, table_count;
    double window;            /* s */
    double flat;              /* log standard deviation of the prior of mean and slope, 1 / noise */
    const long long *time;    /* (N), ns */
    const long long *windows; /* (3, T): the frame of the instant, the oldest, the newest */
    const long long *left_out;
    const double *angle, *turns, *position, *angle_information, *position_information, *noise;
    const Table *tables;
    double *results; /* see `write_results` */
    Table lacking;   /* the table to make before the next call */
} Call;

enum { NO_MEMORY = -2, NO_FRAMES, DONE, LACKING };

/* Returns DONE, LACKING if `lacking` has to be made before another call, or an error below 0. */
int kinpole_derive(Call *call);
