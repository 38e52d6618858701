/*
 * The bytes of messages: a copy of a template, with a stamp and doubles written into it.
 *
 * numpy needs about 10 calls for each topic, which cost 0.4 ms a frame in a node that sleeps
 * between frames. The rows are made in _rows.py, which says what the topics are.
 */

#include <math.h>
#include <string.h>

#include "../include/messages.h"
#include "numbers.h"
#include "poles.h"

/* The doubles of any message of one quantity: their order is that in the message. */
typedef union {
    double vector[3];
    PoseDoubles pose;
    OdometryDoubles odometry;
} Doubles;

/* A message to be written: of a row, of instant `t`, and of the pose `at` of the motion, which has
   so many bodies. */
typedef struct {
    const Motion *motion;
    const Plane *plane;
    const Row *row;
    long long bodies, t, at;
} Task;

/* The quantity of a message, with its covariance and flags: GIVEN by the row, of a pair of bodies,
   or of one body. */
static Quantity
quantity_of(const Task *task)
{
    const Motion *m = task->motion;
    const Row *row = task->row;
    long long other = task->t * task->bodies + row->other;
    switch (row->quantity) {
    case GIVEN: {
        const double *given = row->covariance + 4 * task->t;
        int flags = row->determined[task->t] ? DETERMINED : 0;
        return (Quantity){row->value[task->t], {given[0], given[1], given[3]}, flags, KNOWN};
    }
    case RELATIVE_RATE:
        return kinpole_relative_rate(m, other, task->at);
    case RELATIVE_CENTER:
        return kinpole_relative_center(m, other, task->at);
    default:
        return kinpole_quantity(m, task->at, (int)row->quantity);
    }
}

/* Writes the vector or point `value` of the plane, at `height` over it, to `out` (3), along the
   axes of the frame of the message. */
static void
in_space(const Plane *plane, Number value, double height, double *out)
{
    const double(*e)[3] = plane->basis;
    for (int c = 0; c < 3; c++)
        out[c] = creal(value) * e[0][c] + cimag(value) * e[1][c] + height * e[2][c];
}

/* A standard deviation; 0 for a variance that is not positive. */
static double
root_of(double variance)
{
    return variance > 0.0 ? sqrt(variance) : 0.0;
}

/* The element `c`, `d`, 0 to 2, of a `covariance` (xx, xy, yy) of the plane along the axes of the
   frame of the message. */
static double
covariance_in_space(const Plane *plane, const double *covariance, int c, int d)
{
    const double *x = plane->basis[0], *y = plane->basis[1];
    return x[c] * x[d] * covariance[0] + (x[c] * y[d] + y[c] * x[d]) * covariance[1] +
        y[c] * y[d] * covariance[2];
}

/* Writes the quantity of a message, or its standard deviation, to `out`. Returns the number of
   doubles; 0 if it is undetermined, and nothing is written. */
static int
write_quantity(const Task *task, Doubles *out)
{
    const Row *row = task->row;
    const Plane *plane = task->plane;
    Quantity q = quantity_of(task);
    if (!(q.flags & DETERMINED))
        return 0;
    double height = row->kind == VECTOR ? 0.0 : task->motion->height[task->at];
    double number = row->is_deviation ? root_of(q.covariance[0]) : creal(q.value);
    if (row->kind == NORMAL)
        in_space(plane, 0.0, number, out->vector);
    else if (row->is_deviation)
        for (int c = 0; c < 3; c++)
            out->vector[c] = root_of(covariance_in_space(plane, q.covariance, c, c));
    else
        in_space(plane, q.value, height, out->vector);
    if (row->kind != POSE || row->is_deviation)
        return VECTOR_DOUBLES;
    PoseDoubles pose = {.orientation = {[3] = 1.0}};
    memcpy(pose.position, out->vector, sizeof pose.position);
    for (int c = 0; c < 3; c++)
        for (int d = 0; d < 3; d++)
            pose.covariance[c][d] = covariance_in_space(plane, q.covariance, c, d);
    out->pose = pose;
    return POSE_DOUBLES;
}

/* The frame of a body: where it is and how it moves. */
typedef struct {
    Number origin, velocity;  /* of the frame, m and m/s */
    Number arm;               /* from there to the point whose position is derived, m */
    Number half_turn;         /* unit vector at half of its angle */
    double rate;              /* rad/s */
    double of_angle[2][2];    /* covariance of angle and rate */
    double of_position[2];    /* variances of a coordinate of that point, and of its velocity */
} Pose;

/* Reads the pose `t` of a motion. Returns whether anything is known of it; if not, nothing is
   written. */
static int
read_pose(const Motion *m, long long t, Pose *pose)
{
    long long step = m->stride, row = m->orders * step;
    double angle = m->angle[t];
    if (!kinpole_is_known(m, t))
        return 0;
    pose->rate = m->angle[step + t];
    pose->half_turn = cos(0.5 * angle) + I * sin(0.5 * angle);
    pose->arm = kinpole_arm(m, t);
    pose->origin = m->position[t] - pose->arm;
    pose->velocity = m->position[step + t] - I * pose->rate * pose->arm;
    for (int k = 0; k < 2; k++) {
        for (int l = 0; l < 2; l++)
            pose->of_angle[k][l] = m->angle_covariance[k * row + l * step + t];
        pose->of_position[k] = m->position_covariance[k * row + k * step + t];
    }
    return 1;
}

/* Computes the covariance `out` (3, 3) of x, y and an angle in the plane, or of their rates, from
   their partial derivatives `by` (3, 2) by the angle and the rate of a body. The variance of x and
   y besides is `even`: errors of the point whose position is derived are independent. */
static void
covariance_of(const Pose *pose, const double (*by)[2], double even, double (*out)[3])
{
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) {
            out[i][j] = i == j && i < 2 ? even : 0.0;
            for (int k = 0; k < 2; k++)
                for (int l = 0; l < 2; l++)
                    out[i][j] += by[i][k] * pose->of_angle[k][l] * by[j][l];
        }
}

/* Writes the covariance `out` (6, 6) in space, as ROS orders it: x, y, z, and rotations about them.
   `by` and `even` are those of `covariance_of`. */
static void
write_covariance(const Plane *plane, const Pose *pose, const double (*by)[2], double even,
                 double (*out)[6])
{
    const double(*e)[3] = plane->basis;
    double flat[3][3], turn[3][6] = {{0.0}};
    covariance_of(pose, by, even, flat);
    for (int c = 0; c < 3; c++)
        turn[0][c] = e[0][c], turn[1][c] = e[1][c], turn[2][3 + c] = e[2][c];
    for (int c = 0; c < 6; c++)
        for (int d = 0; d <= c; d++) {
            double sum = 0.0;
            for (int i = 0; i < 3; i++)
                for (int j = 0; j < 3; j++)
                    sum += turn[i][c] * flat[i][j] * turn[j][d];
            /* Nothing is measured along the normal, or about the axes of the plane. */
            if (c < 3)
                sum += plane->unmeasured * e[2][c] * e[2][d];
            else if (d >= 3)
                sum += plane->unmeasured * (e[0][c - 3] * e[0][d - 3] + e[1][c - 3] * e[1][d - 3]);
            out[c][d] = out[d][c] = sum;
        }
}

/* Writes to `out` where the frame of a body is, and for odometry its covariance, and its twist in
   that frame with its covariance (REP-105). Returns the number of doubles; 0 if nothing is known,
   and nothing is written. */
static int
write_pose(const Task *task, Doubles *out)
{
    Pose pose;
    PoseDoubles *at = &out->odometry.pose;
    TwistDoubles *twist = &out->odometry.twist;
    const Plane *plane = task->plane;
    if (!read_pose(task->motion, task->at, &pose))
        return 0;
    in_space(plane, pose.origin, task->motion->height[task->at], at->position);
    in_space(plane, 0.0, cimag(pose.half_turn), at->orientation);
    at->orientation[3] = creal(pose.half_turn);
    if (task->row->kind == FRAME)
        return FRAME_DOUBLES;
    Number turn = pose.half_turn * pose.half_turn;
    in_space(plane, pose.velocity * conj(turn), 0.0, twist->linear);
    in_space(plane, 0.0, pose.rate, twist->angular);
    /* The origin turns about the reference point, and the velocity of that point is seen from the
       body. */
    Number seen = task->motion->position[task->motion->stride + task->at] * conj(turn);
    Number arm = task->motion->reference[task->at];
    double by_pose[3][2] = {{cimag(pose.arm)}, {-creal(pose.arm)}, {1.0}};
    double by_twist[3][2] = {{cimag(seen), cimag(arm)}, {-creal(seen), -creal(arm)}, {0.0, 1.0}};
    write_covariance(plane, &pose, by_pose, pose.of_position[0], at->covariance);
    write_covariance(plane, &pose, by_twist, pose.of_position[1], twist->covariance);
    return ODOMETRY_DOUBLES;
}

/* A vector of the plane with its covariance, and a scalar with its standard deviation, as they are
   in the topic `state`. */
typedef struct {
    double x, y, xx, xy, yy;
} StateVector;

typedef struct {
    double value, deviation;
} StateScalar;

/* The point of a body of the topic `state`, before its quantities: the place of its frame for
   viewers, which quantities are determined, by bits, and its pose and velocity. See _state.py. */
typedef struct {
    float place[3];
    unsigned determined;
    StateVector position;
    StateScalar angle;
    StateVector velocity;
} StatePoint;

/* The vector `value` of the plane, m or m/s, with its covariance (xx, xy, yy). */
static StateVector
state_vector(Number value, double xx, double xy, double yy)
{
    return (StateVector){creal(value), cimag(value), xx, xy, yy};
}

/* Writes position, m, angle, rad, and velocity, m/s, of the frame of a body to its point. An error
   d of the angle moves the origin by -i d r, with r the arm, and changes its velocity by d w r; an
   error e of the rate w changes the velocity by -i e r. */
static void
fill_state_pose(const Pose *pose, double angle, StatePoint *point)
{
    double x = creal(pose->arm), y = cimag(pose->arm), w = pose->rate, flat[3][3];
    const double by_origin[3][2] = {{y}, {-x}}, by_velocity[3][2] = {{w * x, y}, {w * y, -x}};
    covariance_of(pose, by_origin, pose->of_position[0], flat);
    point->position = state_vector(pose->origin, flat[0][0], flat[0][1], flat[1][1]);
    point->angle = (StateScalar){angle, root_of(pose->of_angle[0][0])};
    covariance_of(pose, by_velocity, pose->of_position[1], flat);
    point->velocity = state_vector(pose->velocity, flat[0][0], flat[0][1], flat[1][1]);
}

/* Room for the reasons of the pose and of all 12 quantities of a body: a multiple of 8. */
enum { STATE_REASONS = 16 };

/* Which quantities of a body are determined, by bits, and why the others are not: the pose, and
   then the `count` - 1 that were written. */
typedef struct {
    unsigned determined;
    int count;
    unsigned char reasons[STATE_REASONS];
} Verdicts;

/* Appends to `verdicts` whether a quantity is determined, and its `reason`, one of REASONS. */
static void
add_verdict(Verdicts *verdicts, int is_determined, int reason)
{
    verdicts->determined |= (unsigned)(is_determined != 0) << verdicts->count;
    verdicts->reasons[verdicts->count++] = (unsigned char)reason;
}

/* Writes a quantity of the pose `at`, zeros if it is undetermined, to `out`, and whether it is
   determined to `verdicts`. Returns where it ends. */
static unsigned char *
write_state_quantity(const Task *task, long long at, int quantity, Verdicts *verdicts,
                     unsigned char *out)
{
    Quantity q = kinpole_quantity(task->motion, at, quantity);
    StateVector vector = {0};
    StateScalar scalar = {0};
    int is_scalar = quantity > RATE || quantity == CURVATURE || quantity == CIRCLE_DIAMETER;
    if (q.flags & DETERMINED) {
        vector = state_vector(q.value, q.covariance[0], q.covariance[1], q.covariance[2]);
        scalar = (StateScalar){creal(q.value), root_of(q.covariance[0])};
    }
    add_verdict(verdicts, q.flags & DETERMINED, q.reason);
    size_t size = is_scalar ? sizeof scalar : sizeof vector;
    memcpy(out, is_scalar ? (const void *)&scalar : &vector, size);
    return out + size;
}

/* Writes the point of the pose `at` of the topic `state`, with derivatives up to an order, to
   `out`, and returns where it ends: the point, its quantities, and what the row adds. */
static unsigned char *
write_state_point(const Task *task, long long at, int order, unsigned char *out)
{
    StatePoint point = {0};
    unsigned char *next = out + sizeof point;
    Verdicts verdicts = {0};
    double origin[3] = {0.0}, most = 3.4028234663852886e38;
    Pose pose;
    int has_pose = read_pose(task->motion, at, &pose);
    add_verdict(&verdicts, has_pose, kinpole_missing(task->motion, at));
    if (has_pose) {
        in_space(task->plane, pose.origin, task->motion->height[at], origin);
        fill_state_pose(&pose, task->motion->angle[at], &point);
    }
    for (int c = 0; c < 3; c++)
        point.place[c] = (float)fmin(fmax(origin[c], -most), most);
    for (int k = 1; k <= order; k++)
        next = write_state_quantity(task, at, RATE + k, &verdicts, next);
    for (int k = 1; k <= order; k++)
        next = write_state_quantity(task, at, k, &verdicts, next);
    if (order >= 2)
        next = write_state_quantity(task, at, VELOCITY, &verdicts, next);
    if (order >= 3)
        next = write_state_quantity(task, at, CURVATURE, &verdicts, next);
    for (int k = CIRCLE_CENTER; order >= 2 && k <= CIRCLE_DIAMETER; k++)
        next = write_state_quantity(task, at, k, &verdicts, next);
    point.determined = verdicts.determined;
    memcpy(out, &point, sizeof point);
    /* Doubles follow, at a multiple of their size. */
    size_t size = (verdicts.count + sizeof(double) - 1) / sizeof(double) * sizeof(double);
    memcpy(next, verdicts.reasons, size);
    next += size;
    long long count = task->row->added_count;
    if (count > 0)
        memcpy(next, task->row->added + at * count, count * sizeof *task->row->added);
    return next + count * sizeof *task->row->added;
}

/* Writes the bytes of a message to `out`, and returns whether there is one: whether what it is of
   is determined, and all of its doubles are finite. */
static int
write_message(const Task *task, unsigned char *out)
{
    const Row *row = task->row;
    long long stamp = task->motion->stamp[task->t];
    int time[] = {(int)(stamp / SECOND), (int)(stamp % SECOND)};
    memcpy(out, row->template, row->message_bytes);
    /* A list has its length before the header of its first item. */
    memcpy(out + (row->kind == FRAME ? 8 : 4), time, sizeof time);
    out += row->head;
    if (row->kind == STATE) {
        for (long long b = 0; b < task->bodies; b++)
            out = write_state_point(task, task->t * task->bodies + b, (int)row->order, out);
        return 1;
    }
    Doubles doubles;
    const double *values = (const double *)&doubles;
    int is_pose = row->kind == ODOMETRY || row->kind == FRAME;
    int count = is_pose ? write_pose(task, &doubles) : write_quantity(task, &doubles);
    for (int k = 0; k < count; k++)
        if (!isfinite(values[k]))
            return 0;
    memcpy(out, values, count * sizeof *values);
    return count > 0;
}

void
kinpole_write_rows(const Motion *motion, long long bodies, const Plane *plane, const Row *rows,
                   long long number, unsigned char *out, unsigned char *made)
{
    for (const Row *row = rows; row < rows + number; row++)
        for (long long t = 0; t < motion->poses / bodies; t++, out += row->message_bytes) {
            Task task = {motion, plane, row, bodies, t, t * bodies + row->body};
            *made++ = (unsigned char)write_message(&task, out);
        }
}
