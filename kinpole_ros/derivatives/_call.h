/*
 * The arguments and the return values of `kinpole_derive`, which other parts of the library call too.
 */

/* What is made once for a kind of window, of so many samples each the mean of a block: models if
   `orders` is 0, slopes if it is -1, or stencils of an instant so many samples from the middle.
   `exact` says that samples are all but exact. */
typedef struct {
    long long count, block, exact, orders;
    double at;
    const long long *integers;
    const double *numbers;
} Table;

/* The arguments of `derive_poses` in _poses.py, which says what they are: arrays (N, B) of B bodies
   in N frames, and (T, B) of T instants; `windows` (3, T) are the frame of the instant and the
   oldest and newest frames. Signals before `next` are done; `lacking` is the table to make before
   the next call. */
typedef struct {
    long long frames, bodies, instants, next, orders, table_count;
    double window, flat; /* s; logarithm of the deviation of a flat prior */
    const long long *time, *windows, *left_out;
    const double *angle, *turns, *position, *angle_information, *position_information, *noise;
    const Table *tables;
    double *results;
    Table lacking;
} Call;

enum { NO_MEMORY = -2, NO_FRAMES, DONE, LACKING };

/* Returns 0, or why it has to be called again, or that there is no memory. */
int kinpole_derive(Call *call);
