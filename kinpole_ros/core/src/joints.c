/*
 * The bytes of sensor_msgs/JointState: angles and rates of joints, or their standard deviations.
 */

#include <math.h>
#include <string.h>

#include "../include/messages.h"
#include "numbers.h"
#include "poles.h"

/* Adds to `sums` (2) the angle, rad, and the rate, rad/s, of a body `seconds` after instant `t`,
   times `sign`, by Taylor series up to the acceleration; or their variances, which have no sign and
   are at least 0, if the joints are for deviations. A body of -1 is the ground, which adds nothing.
   Returns whether the body is known. */
static int
add_state(const Motion *m, const Joints *joints, long long body, long long t, double seconds,
          double sign, double *sums)
{
    if (body < 0)
        return 1;
    long long at = t * joints->bodies + body, orders = m->orders < 3 ? m->orders : 3;
    const double series[] = {1.0, seconds, seconds * seconds / 2};
    for (long long order = 0; order < 2; order++) {
        double value = 0.0, variance = 0.0;
        for (long long k = order; k < orders; k++) {
            value += series[k - order] * m->angle[k * m->stride + at];
            for (long long l = order; l < orders; l++)
                variance += series[k - order] * series[l - order] *
                    m->angle_covariance[(k * m->orders + l) * m->stride + at];
        }
        if (joints->is_deviation)
            sums[order] += variance > 0.0 ? variance : 0.0;
        else
            sums[order] += sign * value;
    }
    return kinpole_is_known(m, at);
}

/* Writes the integer `value` at `out`, or up to 3 bytes later, so that it is a multiple of 4 bytes
   after `start`; returns where it ends. */
static unsigned char *
put_integer(unsigned char *start, unsigned char *out, int value)
{
    out += -(out - start) & 3;
    memcpy(out, &value, sizeof value);
    return out + sizeof value;
}

/* Writes the message of instant `t`, extrapolated to a stamp, ns, to `out`: a header, the names of
   the joints whose bodies are known, their angles, and their rates. Returns its bytes; 0 without
   joints. */
static long long
write_joint_state(const Motion *m, const Joints *joints, long long t, long long stamp,
                  unsigned char *out)
{
    double seconds = (double)(stamp - m->stamp[t]) * 1e-9;
    int listed = 0;
    memset(out, 0, joints->message_bytes);
    out[1] = 1; /* little endian */
    unsigned char *start = out + 4, *at = put_integer(start, start, (int)(stamp / SECOND));
    at = put_integer(start, at, (int)(stamp % SECOND));
    at = put_integer(start, at, 1) + 1; /* the empty frame_id */
    unsigned char *number = at + (-(at - start) & 3);
    at = number + 4;
    /* The states follow all names, and wait for them behind the longest message. */
    unsigned char *states = out + joints->message_bytes - 16 * joints->joints;
    for (long long k = 0; k < joints->joints; k++) {
        double sums[2] = {0.0, 0.0}, state[2];
        int is_known = add_state(m, joints, joints->second_body[k], t, seconds, 1.0, sums);
        is_known &= add_state(m, joints, joints->first_body[k], t, seconds, -1.0, sums);
        if (!is_known || !isfinite(sums[0]) || !isfinite(sums[1]))
            continue;
        state[0] = joints->is_deviation ? sqrt(sums[0]) : atan2(sin(sums[0]), cos(sums[0]));
        state[1] = joints->is_deviation ? sqrt(sums[1]) : sums[1];
        memcpy(states + 16 * listed++, state, sizeof state);
        long long length = joints->ends[k + 1] - joints->ends[k];
        at = put_integer(start, at, (int)length);
        memcpy(at, joints->names + joints->ends[k], length);
        at += length;
    }
    put_integer(start, number, listed);
    for (int order = 0; order < 2; order++) {
        at = put_integer(start, at, listed);
        at += -(at - start) & 7;
        for (int k = 0; k < listed; k++, at += 8)
            memcpy(at, states + 16 * k + 8 * order, 8);
    }
    /* No efforts, but padding up to where they would begin. */
    at = put_integer(start, at, 0);
    at += -(at - start) & 7;
    return listed ? at - out : 0;
}

void
kinpole_write_joints(const Motion *motion, const Joints *joints, const long long *stamps,
                     const long long *nearest, long long count, unsigned char *out,
                     long long *lengths)
{
    for (long long k = 0; k < count; k++, out += joints->message_bytes)
        lengths[k] = write_joint_state(motion, joints, nearest[k], stamps[k], out);
}
