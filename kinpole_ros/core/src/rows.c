/*
 * The bytes of messages: a copy of a template, with a stamp and doubles written into it.
 *
 * numpy needs about 10 calls for each topic, which cost 0.4 ms a frame in a node that sleeps between
 * frames. The rows are made in _rows.py, which says what the topics are.
 */

#include <math.h>
#include <string.h>

#include "../include/codes.h"
#include "../include/messages.h"
#include "poles.h"

/* A message to be written: of instant `t`, and of the body with the element `at` of the motion. */
typedef struct {
    const Motion *motion;
    const Plane *plane;
    const Row *row;
    long long bodies, t, at;
} Task;

static Quantity
quantity_of(const Task *task)
{
    const Motion *m = task->motion;
    const Row *row = task->row;
    long long other = task->t * task->bodies + row->other;
    switch (row->what) {
    case GIVEN: {
        const double *spread = row->spread + 4 * task->t;
        int flags = row->determined[task->t] ? DETERMINED : 0;
        return (Quantity){row->value[task->t], {spread[0], spread[1], spread[3]}, flags};
    }
    case RELATIVE_RATE:
        return kinpole_relative_rate(m, other, task->at);
    case RELATIVE_CENTER:
        return kinpole_relative_center(m, other, task->at);
    default:
        return row->what > RATE ? kinpole_rate(m, task->at, (int)row->what - RATE)
                                : kinpole_quantity(m, task->at, (int)row->what);
    }
}

static void
in_space(const Plane *plane, Number value, double height, double *out)
{
    const double(*e)[3] = plane->basis;
    for (int c = 0; c < 3; c++)
        out[c] = creal(value) * e[0][c] + cimag(value) * e[1][c] + height * e[2][c];
}

static double
root_of(double variance)
{
    return variance > 0.0 ? sqrt(variance) : 0.0;
}

/* The element (c, d) of a covariance xx, xy, yy of the plane, along axes of the frame. */
static double
turned(const Plane *plane, const double *spread, int c, int d)
{
    const double *x = plane->basis[0], *y = plane->basis[1];
    return x[c] * x[d] * spread[0] + (x[c] * y[d] + y[c] * x[d]) * spread[1] +
        y[c] * y[d] * spread[2];
}

/* Writes a quantity, and returns the number of doubles; 0 where it is undetermined. */
static int
write_quantity(const Task *task, double *out)
{
    const Row *row = task->row;
    const Plane *plane = task->plane;
    Quantity q = quantity_of(task);
    if (!(q.flags & DETERMINED))
        return 0;
    if (row->kind == NORMAL) {
        in_space(plane, 0.0, row->is_deviation ? root_of(q.spread[0]) : creal(q.value), out);
        return 3;
    }
    if (row->is_deviation) {
        for (int c = 0; c < 3; c++)
            out[c] = root_of(turned(plane, q.spread, c, c));
        return 3;
    }
    in_space(plane, q.value, row->kind == VECTOR ? 0.0 : task->motion->height[task->at], out);
    if (row->kind != POSE)
        return 3;
    memset(out + 3, 0, 40 * sizeof *out);
    out[6] = 1.0;
    for (int c = 0; c < 3; c++)
        for (int d = 0; d < 3; d++)
            out[7 + 6 * c + d] = turned(plane, q.spread, c, d);
    return 43;
}

/* The frame of a body: where it is and how it moves. */
typedef struct {
    Number origin, velocity, arm, half_turn;
    double rate, of_angle[2][2], of_position[2];
} Pose;

/* Returns whether anything is known of the body. */
static int
read_pose(const Motion *m, long long t, Pose *pose)
{
    long long step = m->stride, row = m->orders * step;
    double angle = m->angle[t];
    if (!kinpole_is_known(m, t))
        return 0;
    pose->rate = m->angle[step + t];
    pose->half_turn = cos(0.5 * angle) + I * sin(0.5 * angle);
    pose->arm = m->reference[t] * (cos(angle) + I * sin(angle));
    pose->origin = m->position[t] - pose->arm;
    pose->velocity = m->position[step + t] - I * pose->rate * pose->arm;
    for (int k = 0; k < 2; k++) {
        for (int l = 0; l < 2; l++)
            pose->of_angle[k][l] = m->angle_covariance[k * row + l * step + t];
        pose->of_position[k] = m->position_covariance[k * row + k * step + t];
    }
    return 1;
}

/* The covariance of x, y and an angle in the plane, from their derivatives `by` angle and rate. The
   variance of x and y besides is `even`: errors of the reference point are independent. */
static void
covariance_of(const Pose *pose, const double (*by)[2], double even, double (*cells)[3])
{
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) {
            cells[i][j] = i == j && i < 2 ? even : 0.0;
            for (int k = 0; k < 2; k++)
                for (int l = 0; l < 2; l++)
                    cells[i][j] += by[i][k] * pose->of_angle[k][l] * by[j][l];
        }
}

/* Writes the covariance (6, 6) in space, as ROS orders it. */
static void
write_covariance(const Plane *plane, const Pose *pose, const double (*by)[2], double even, double *out)
{
    const double(*e)[3] = plane->basis;
    double cells[3][3], turn[3][6] = {{0.0}};
    covariance_of(pose, by, even, cells);
    for (int c = 0; c < 3; c++)
        turn[0][c] = e[0][c], turn[1][c] = e[1][c], turn[2][3 + c] = e[2][c];
    for (int c = 0; c < 6; c++)
        for (int d = 0; d <= c; d++) {
            double sum = 0.0;
            for (int i = 0; i < 3; i++)
                for (int j = 0; j < 3; j++)
                    sum += turn[i][c] * cells[i][j] * turn[j][d];
            /* Nothing is measured along the normal, or about the axes of the plane. */
            if (c < 3)
                sum += plane->unmeasured * e[2][c] * e[2][d];
            else if (d >= 3)
                sum += plane->unmeasured * (e[0][c - 3] * e[0][d - 3] + e[1][c - 3] * e[1][d - 3]);
            out[6 * c + d] = out[6 * d + c] = sum;
        }
}

/* Writes where the frame of a body is, and for odometry its twist in that frame (REP-105). */
static int
write_pose(const Task *task, double *out)
{
    Pose pose;
    const Plane *plane = task->plane;
    if (!read_pose(task->motion, task->at, &pose))
        return 0;
    in_space(plane, pose.origin, task->motion->height[task->at], out);
    in_space(plane, 0.0, cimag(pose.half_turn), out + 3);
    out[6] = creal(pose.half_turn);
    if (task->row->kind == FRAME)
        return 7;
    Number turn = pose.half_turn * pose.half_turn;
    in_space(plane, pose.velocity * conj(turn), 0.0, out + 43);
    in_space(plane, 0.0, pose.rate, out + 46);
    /* The origin turns about the reference point, and the velocity of that point is seen from the
       body. */
    Number seen = task->motion->position[task->motion->stride + task->at] * conj(turn);
    Number arm = task->motion->reference[task->at];
    double by_pose[3][2] = {{cimag(pose.arm)}, {-creal(pose.arm)}, {1.0}};
    double by_twist[3][2] = {{cimag(seen), cimag(arm)}, {-creal(seen), -creal(arm)}, {0.0, 1.0}};
    write_covariance(plane, &pose, by_pose, pose.of_position[0], out + 7);
    write_covariance(plane, &pose, by_twist, pose.of_position[1], out + 49);
    return 85;
}

/* Writes a vector of the plane with its covariance for `state`. */
static void
write_state_vector(Number value, double xx, double xy, double yy, double *out)
{
    out[0] = creal(value), out[1] = cimag(value), out[2] = xx, out[3] = xy, out[4] = yy;
}

/* Writes position, angle and velocity of the frame of a body for `state`. An error d of the angle moves
   the origin by -i d r, with r the arm, and changes its velocity by d w r; an error e of the rate w
   changes the velocity by -i e r. */
static void
write_state_pose(const Pose *pose, double angle, double *out)
{
    double x = creal(pose->arm), y = cimag(pose->arm), w = pose->rate, cells[3][3];
    const double by_origin[3][2] = {{y}, {-x}}, by_velocity[3][2] = {{w * x, y}, {w * y, -x}};
    covariance_of(pose, by_origin, pose->of_position[0], cells);
    write_state_vector(pose->origin, cells[0][0], cells[0][1], cells[1][1], out);
    out[5] = angle, out[6] = root_of(pose->of_angle[0][0]);
    covariance_of(pose, by_velocity, pose->of_position[1], cells);
    write_state_vector(pose->velocity, cells[0][0], cells[0][1], cells[1][1], out + 7);
}

/* Writes a quantity for `state`, and returns the number of doubles; all are 0 if it is undetermined. */
static int
write_state_quantity(const Quantity *q, int is_vector, double *out)
{
    int is_determined = q->flags & DETERMINED;
    for (int k = 0; k < 5; k++)
        out[k] = 0.0;
    if (is_determined && is_vector)
        write_state_vector(q->value, q->spread[0], q->spread[1], q->spread[2], out);
    else if (is_determined)
        out[0] = creal(q->value), out[1] = root_of(q->spread[0]);
    return is_vector ? 5 : 2;
}

/* Writes the point of a body of the topic `state`, with derivatives up to an order, and returns its
   bytes. See _state.py. */
static long long
write_state_point(const Task *task, long long at, int order, unsigned char *out)
{
    const Motion *m = task->motion;
    enum { POSE_FIELDS = 12, FIRST = 16 };
    double doubles[POSE_FIELDS + 7 * HIGHEST + 7 + 3] = {0}, origin[3] = {0.0}, *next = doubles;
    unsigned determined = 0, bit = 2;
    Pose pose;
    if (read_pose(m, at, &pose)) {
        determined = 1;
        in_space(task->plane, pose.origin, m->height[at], origin);
        write_state_pose(&pose, m->angle[at], next);
    }
    next += POSE_FIELDS;
    /* Rates, poles, from order 2 on the velocity of the ICR, from order 3 on the curvature. */
    int count = 2 * order + (order >= 2) + (order >= 3);
    for (int k = 1; k <= count; k++, bit *= 2) {
        int what = k - order <= order ? k - order : VELOCITY + k - 2 * order - 1;
        Quantity q = k <= order ? kinpole_rate(m, at, k) : kinpole_quantity(m, at, what);
        next += write_state_quantity(&q, k > order && what != CURVATURE, next);
        determined |= q.flags & DETERMINED ? bit : 0;
    }
    for (int c = 0; c < 3; c++) {
        double most = 3.4028234663852886e38;
        float near = (float)fmin(fmax(origin[c], -most), most);
        memcpy(out + 4 * c, &near, 4);
    }
    memcpy(out + 12, &determined, 4);
    memcpy(out + FIRST, doubles, (next - doubles) * sizeof *doubles);
    return FIRST + (next - doubles) * (long long)sizeof *doubles;
}

/* Writes a message, and returns whether there is one. */
static int
write_message(const Task *task, unsigned char *out)
{
    const long long second = 1000000000;
    const Row *row = task->row;
    long long stamp = task->motion->stamp[task->t];
    int time[] = {(int)(stamp / second), (int)(stamp % second)};
    memcpy(out, row->template, row->size);
    /* A list has its length before the header of its first item. */
    memcpy(out + (row->kind == FRAME ? 8 : 4), time, sizeof time);
    out += row->head;
    if (row->kind == STATE) {
        for (long long b = 0; b < task->bodies; b++)
            out += write_state_point(task, task->t * task->bodies + b, (int)row->what, out);
        return 1;
    }
    double values[85];
    int is_pose = row->kind == ODOMETRY || row->kind == FRAME;
    int count = is_pose ? write_pose(task, values) : write_quantity(task, values);
    for (int k = 0; k < count; k++)
        if (!isfinite(values[k]))
            return 0;
    memcpy(out, values, count * sizeof *values);
    return count > 0;
}

/* Writes the messages of `number` rows, of all instants of each, to `out`, and to `made` (number,
   instants) whether there is one. */
void
kinpole_write_rows(const Motion *motion, long long bodies, const Plane *plane, const Row *rows,
                   long long number, unsigned char *out, unsigned char *made)
{
    for (const Row *row = rows; row < rows + number; row++)
        for (long long t = 0; t < motion->count / bodies; t++, out += row->size) {
            Task task = {motion, plane, row, bodies, t, t * bodies + row->body};
            *made++ = (unsigned char)write_message(&task, out);
        }
}
