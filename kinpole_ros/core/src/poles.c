/*
 * Poles, the velocity of the ICR, the inflection circle and the curvature of the centrode, with
 * covariances, and where they stand out of their noise. numpy needs about 50 calls for each,
 * however few instants there are. The formulas are those of planar/, and test_quantities.py
 * compares both.
 *
 * Of one body at one instant, `z` (HIGHEST + 1) are the derivatives of its position, m/s^k, complex
 * numbers of the plane, and `rate` (HIGHEST + 1) those of its angle, rad/s^k, both by order. `t` is
 * the number of this pose in the arrays of `Motion`.
 */

#include <math.h>

#include "poles.h"

/* A quantity with its partial derivatives by `z` and by `rate`, by order. A vector has the partial
   derivative u by a real error x in z if it changes by u x, and i u by an error i x. */
typedef struct {
    Number value, by_position[HIGHEST + 1], by_angle[HIGHEST + 1];
} Linear;

/* Adds to `moments` (xx, xy, yy) the covariance of the sum of by[k] e_k over the orders k from 0 to
   `highest`, for real errors e_k. `errors` (orders, orders) are the covariances of these errors;
   its elements are `step` apart. */
static void
add_moments(const double *errors, long long orders, long long step, int highest, const Number *by,
            double *moments)
{
    for (int k = 0; k <= highest; k++) {
        double x = 0.0, y = 0.0;
        for (int l = 0; by[k] != 0.0 && l <= highest; l++) {
            double error = errors[(k * orders + l) * step];
            x += error * creal(by[l]), y += error * cimag(by[l]);
        }
        moments[0] += creal(by[k]) * x, moments[1] += creal(by[k]) * y;
        moments[2] += cimag(by[k]) * y;
    }
}

/* One over a number; NaN for 0, as in numpy. */
static Number
inverse_of(Number number)
{
    return number == 0.0 ? NAN : 1.0 / number;
}

/* Computes the pole of an order, m: the point whose derivative of that order is zero, z_0 - z_n / a
   with the rotation coefficient a, the n-th derivative of exp(i angle) over exp(i angle). `turn`
   gets a, 1/s^n. Writes the elements of both that are not zero. */
static void
pole(int order, const Number *z, const double *rate, Linear *turn, Linear *out)
{
    static const double choose[HIGHEST + 1][HIGHEST + 1] = {
        {1}, {1, 1}, {1, 2, 1}, {1, 3, 3, 1}, {1, 4, 6, 4, 1}};
    Number a[HIGHEST + 1] = {1.0};
    for (int n = 1; n <= order; n++)
        for (int k = 1; k <= n; k++)
            a[n] += choose[n - 1][k - 1] * rate[k] * (I * a[n - k]);
    Number inverse = -inverse_of(a[order]), arm = z[order] * inverse;
    turn->value = a[order], out->value = z[0] + arm;
    out->by_position[0] = 1.0, out->by_position[order] = inverse;
    for (int k = 1; k <= order; k++) {
        turn->by_angle[k] = choose[order][k] * (I * a[order - k]);
        out->by_angle[k] = arm * inverse * turn->by_angle[k];
    }
}

/* Computes the velocity of the ICR along the centrodes, m/s: how fast the pole of order 1 moves. */
static void
velocity(const Number *z, const double *rate, Linear *out)
{
    Number q = -inverse_of(I * rate[1]), n = I * rate[2] * q, nv = n * z[1], iqq = I * q * q;
    Number inner = z[2] + nv;
    out->value = z[1] + q * inner;
    out->by_position[1] = 1.0 + n * q, out->by_position[2] = q;
    out->by_angle[1] = iqq * (inner + nv), out->by_angle[2] = iqq * z[1];
}

/* Computes the acceleration of the ICR over its speed squared, 1/m. Its real part is that across
   the velocity: the curvature of the fixed centrode, of which the partial derivatives are. */
static void
curvature(const Number *z, const double *rate, Linear *out)
{
    velocity(z, rate, out);
    Number u = out->value, *p = out->by_position, *a = out->by_angle, q = p[2];
    Number n = I * rate[2] * q, m = I * rate[3] * q, iqq = I * q * q, c = m + n * n;
    /* Partial derivatives of the acceleration of the ICR. */
    Number dp[] = {0.0, (c + n * n) * q, p[1] + n * q, q};
    Number da[] = {0.0, 2 * n * a[1] + iqq * (z[3] + 2 * n * z[2] + 2 * c * z[1]), 2 * a[1], a[2]};
    Number du = dp[1] * z[1] + dp[2] * z[2] + dp[3] * z[3];
    Number inverse = inverse_of(u), g = du * inverse;
    double slowness = cabs(inverse);
    Number by_du = -I * inverse * slowness, by_u = by_du * (0.5 * conj(g) - 1.5 * g);
    for (int k = 1; k <= 3; k++)
        p[k] = by_du * dp[k] + by_u * p[k], a[k] = by_du * da[k] + by_u * a[k];
    out->value = -I * g * slowness;
}

/* Computes the center of the inflection circle, m, and its diameter as a vector from the ICR to the
   inflection pole, m: see planar/_curvature.py. */
static void
circle(const Number *z, const double *rate, Linear *center, Linear *diameter)
{
    Linear icr = {0}, u = {0}, turn = {0};
    pole(1, z, rate, &turn, &icr);
    velocity(z, rate, &u);
    Number slowness = inverse_of(rate[1]), factor = -I * slowness;
    diameter->value = factor * u.value;
    center->value = icr.value + diameter->value / 2;
    for (int k = 0; k <= 2; k++) {
        diameter->by_position[k] = factor * u.by_position[k];
        diameter->by_angle[k] = factor * u.by_angle[k];
        diameter->by_angle[k] -= k == 1 ? diameter->value * slowness : 0.0;
        center->by_position[k] = icr.by_position[k] + diameter->by_position[k] / 2;
        center->by_angle[k] = icr.by_angle[k] + diameter->by_angle[k] / 2;
    }
}

/* An ICR moves if its speed exceeds its root mean square error this many times, and this share of
   the body size per rad. */
static const double MOVING = 1.7, STILL = 1e-6;
/* A curvature is determined if the ICR moves, and the body turns by more than so many standard
   deviations. */
static const double TURNING = 1.5;

/* Adds to `covariance` (xx, xy, yy) the covariance of a quantity that follows from those of
   position and angle, by its partial derivatives of the orders up to `highest`. */
static void
add_covariance(const Motion *m, long long t, int highest, const Linear *linear, double *covariance)
{
    double by_position[3] = {0};
    add_moments(m->angle_covariance + t, m->orders, m->stride, highest, linear->by_angle,
                covariance);
    add_moments(m->position_covariance + t, m->orders, m->stride, highest, linear->by_position,
                by_position);
    /* The two coordinates of the position have independent errors of one covariance. */
    covariance[0] += by_position[0] + by_position[2];
    covariance[2] += by_position[0] + by_position[2];
}

/* Whether a quantity and its covariance are finite. */
static int
is_known(const Quantity *q)
{
    return isfinite(creal(q->value)) && isfinite(cimag(q->value)) && isfinite(q->covariance[0]) &&
        isfinite(q->covariance[1]) && isfinite(q->covariance[2]);
}

/* Whether a point of the plane, m, is less than FARTHEST body sizes from the position of the body;
   not where anything is NaN. */
static int
is_near(const Motion *m, long long t, Number point)
{
    return cabs(point - m->position[t]) < FARTHEST * m->size[t];
}

/* The root mean square of the error of a vector, in its unit: both coordinates together. */
static double
rms_error_of(const Quantity *q)
{
    return sqrt(q->covariance[0] + q->covariance[2]);
}

/* Reads `z` and `rate` of one pose, up to the order `highest`. */
static void
motion_at(const Motion *m, long long t, int highest, Number *z, double *rate)
{
    for (int k = 0; k <= highest; k++)
        z[k] = m->position[k * m->stride + t], rate[k] = m->angle[k * m->stride + t];
}

/* Whether a point of the plane, m, is more than FARTHEST body sizes away, as good as at infinity;
   not where anything is NaN. */
static int
is_far(const Motion *m, long long t, Number point)
{
    return cabs(point - m->position[t]) > FARTHEST * m->size[t];
}

/* The pole of an order, m, as it follows from the motion. It is determined if the rotation
   coefficient exceeds SIGNIFICANT standard deviations, and the pole is near. */
static Quantity
free_pole(const Motion *m, long long t, int order)
{
    double rate[HIGHEST + 1], noise[3] = {0};
    Number z[HIGHEST + 1];
    Linear linear = {0}, turn = {0};
    Quantity q = {0};
    motion_at(m, t, order, z, rate);
    pole(order, z, rate, &turn, &linear);
    q.value = linear.value;
    add_covariance(m, t, order, &linear, q.covariance);
    add_moments(m->angle_covariance + t, m->orders, m->stride, order, turn.by_angle, noise);
    int is_rotating = cabs(turn.value) > SIGNIFICANT * sqrt(noise[0] + noise[2]);
    q.flags = is_rotating && is_near(m, t, q.value) && is_known(&q) ? DETERMINED : 0;
    if (!q.flags)
        q.reason = is_far(m, t, q.value) ? AT_INFINITY : order > 1 ? IN_NOISE : NO_ROTATION;
    return q;
}

/* The pole of an order, m. That of a body on a pin is the pin, and determined if any rate up to the
   order exceeds SIGNIFICANT standard deviations. */
static Quantity
pole_at(const Motion *m, long long t, int order)
{
    Quantity q = free_pole(m, t, order);
    if (!isfinite(creal(m->pin[t]))) {
        /* A body without an ICR does not turn, whatever else is in its noise. */
        if (q.reason == IN_NOISE && !free_pole(m, t, 1).flags)
            q.reason = NO_ROTATION;
        return q;
    }
    q.value = m->pin[t];
    q.covariance[0] = q.covariance[2] = m->pin_variance[t], q.covariance[1] = 0.0;
    q.reason = NO_ROTATION;
    for (int k = 1; k <= order; k++) {
        double variance = m->angle_covariance[(k * m->orders + k) * m->stride + t];
        if (fabs(m->angle[k * m->stride + t]) > SIGNIFICANT * sqrt(variance))
            q.flags = DETERMINED;
    }
    if (q.flags)
        q.reason = KNOWN;
    return q;
}

/* The velocity of the ICR, m/s, 0 on a pin. MOVES is set if the ICR is near and seen to move. */
static Quantity
velocity_at(const Motion *m, long long t)
{
    double rate[3];
    Number z[3];
    Linear linear = {0};
    Quantity q = {0}, icr = pole_at(m, t, 1);
    int pinned = isfinite(creal(m->pin[t]));
    if (!pinned) {
        motion_at(m, t, 2, z, rate);
        velocity(z, rate, &linear);
        q.value = linear.value;
        add_covariance(m, t, 2, &linear, q.covariance);
    }
    q.flags = icr.flags & DETERMINED && is_known(&q) ? DETERMINED : 0;
    double speed = cabs(q.value), least = STILL * fabs(m->angle[m->stride + t]) * m->size[t];
    if (is_near(m, t, icr.value) && speed > MOVING * rms_error_of(&q) && speed > least)
        q.flags |= MOVES;
    q.reason = q.flags & DETERMINED ? KNOWN : icr.reason ? icr.reason : IN_NOISE;
    return q;
}

/* Why a quantity that follows from the motion of the ICR is undetermined: a velocity within its
   noise does not show a pin, but all poses together do. */
static int
why_no_curvature(const Motion *m, long long t, const Quantity *velocity)
{
    if (velocity->flags & MOVES)
        return IN_NOISE;
    /* Without an ICR its velocity has the reason of that. */
    if (velocity->reason)
        return velocity->reason;
    return isfinite(creal(m->pin[t])) ? ON_PIN : ICR_IN_NOISE;
}

/* The curvature of the fixed centrode, 1/m, determined where the ICR is seen to move. */
static Quantity
curvature_at(const Motion *m, long long t)
{
    double rate[4];
    Number z[4];
    Linear linear = {0};
    Quantity q = {0}, u = velocity_at(m, t);
    motion_at(m, t, 3, z, rate);
    curvature(z, rate, &linear);
    q.value = creal(linear.value);
    add_covariance(m, t, 3, &linear, q.covariance);
    /* The curvature goes by the speed to the power of -2, which is far from linear where the speed
       is noisy: a relative error x of it changes the curvature by 3 x^2 of the acceleration over
       the speed squared, in second order. */
    double slowness = (u.covariance[0] + u.covariance[2]) / 2 / creal(u.value * conj(u.value));
    double second = cabs(linear.value) * slowness;
    double variance = q.covariance[0] + 18 * second * second;
    double turned = m->angle[m->stride + t] / TURNING;
    /* A body that turns by less than its noise would surely have a straight centrode. */
    int is_rotating = turned * turned > m->angle_covariance[(m->orders + 1) * m->stride + t];
    q.flags = u.flags & MOVES;
    if (u.flags & MOVES && is_rotating && isfinite(creal(q.value)) && isfinite(variance))
        q.flags |= DETERMINED;
    q.reason = q.flags & DETERMINED ? KNOWN : why_no_curvature(m, t, &u);
    q.covariance[0] = variance;
    return q;
}

/* The `quantity` CIRCLE_CENTER, m, or CIRCLE_DIAMETER, m, of the inflection circle, determined
   where the ICR is seen to move. */
static Quantity
circle_at(const Motion *m, long long t, int quantity)
{
    double rate[3];
    Number z[3];
    Linear center = {0}, diameter = {0}, *linear = &center;
    Quantity q = {0}, u = velocity_at(m, t);
    motion_at(m, t, 2, z, rate);
    circle(z, rate, &center, &diameter);
    if (quantity == CIRCLE_DIAMETER) {
        linear = &diameter;
        double length = cabs(diameter.value);
        Number along = conj(diameter.value) / length;
        diameter.value = length;
        for (int k = 0; k <= 2; k++)
            diameter.by_position[k] *= along, diameter.by_angle[k] *= along;
    }
    q.value = linear->value;
    add_covariance(m, t, 2, linear, q.covariance);
    q.flags = u.flags & MOVES;
    if (u.flags == (DETERMINED | MOVES) && is_near(m, t, center.value) && is_known(&q))
        q.flags |= DETERMINED;
    if (!(q.flags & DETERMINED))
        q.reason = u.flags & MOVES && is_far(m, t, center.value) ? STRAIGHT
                                                                : why_no_curvature(m, t, &u);
    return q;
}

int
kinpole_is_known(const Motion *m, long long t)
{
    Number velocity = m->position[m->stride + t];
    return isfinite(m->angle[m->stride + t]) && isfinite(creal(velocity)) &&
        isfinite(cimag(velocity));
}

Quantity
kinpole_rate(const Motion *m, long long t, int order)
{
    Quantity q = {0};
    q.value = m->angle[order * m->stride + t];
    q.covariance[0] = m->angle_covariance[order * (m->orders + 1) * m->stride + t];
    q.flags = isfinite(creal(q.value)) ? DETERMINED : 0;
    q.reason = q.flags ? KNOWN : IN_NOISE;
    return q;
}

int
kinpole_missing(const Motion *m, long long t)
{
    return m->reason ? m->reason[t] : KNOWN;
}

/* As `kinpole_quantity`, with the reason as if pose `t` had a result. */
static Quantity
quantity_of_known(const Motion *m, long long t, int quantity)
{
    switch (quantity) {
    case POLE_1: case POLE_2: case POLE_3: case POLE_4:
        return pole_at(m, t, quantity);
    case FREE_POLE_1: case FREE_POLE_2: case FREE_POLE_3: case FREE_POLE_4:
        return free_pole(m, t, quantity - FREE);
    case VELOCITY:
        return velocity_at(m, t);
    case CURVATURE:
        return curvature_at(m, t);
    case CIRCLE_CENTER: case CIRCLE_DIAMETER:
        return circle_at(m, t, quantity);
    case RATE_1: case RATE_2: case RATE_3: case RATE_4:
        return kinpole_rate(m, t, quantity - RATE);
    default:
        return (Quantity){NAN, {NAN, NAN, NAN}, 0, IN_NOISE};
    }
}

Quantity
kinpole_quantity(const Motion *m, long long t, int quantity)
{
    Quantity q = quantity_of_known(m, t, quantity);
    if (kinpole_missing(m, t))
        q.reason = kinpole_missing(m, t);
    return q;
}

Quantity
kinpole_relative_rate(const Motion *m, long long j, long long i)
{
    Quantity q = kinpole_rate(m, j, 1), other = kinpole_rate(m, i, 1);
    q.value -= other.value, q.covariance[0] += other.covariance[0];
    q.flags = isfinite(creal(q.value)) ? DETERMINED : 0;
    return q;
}

Quantity
kinpole_relative_center(const Motion *m, long long j, long long i)
{
    Quantity q = {0}, rate = kinpole_relative_rate(m, j, i);
    const double *w = m->angle + m->stride;
    const Number *z = m->position, *v = z + m->stride;
    Linear by_j = {0}, by_i = {0};
    double inverse = 1.0 / creal(rate.value);
    Number between = z[j] - z[i], arm = (w[j] * between + I * (v[j] - v[i])) * inverse;
    by_j.by_position[0] = w[j] * inverse, by_j.by_position[1] = I * inverse;
    by_i.by_position[0] = -w[i] * inverse, by_i.by_position[1] = -I * inverse;
    by_j.by_angle[1] = (between - arm) * inverse, by_i.by_angle[1] = arm * inverse;
    q.value = z[i] + arm;
    add_covariance(m, j, 1, &by_j, q.covariance);
    add_covariance(m, i, 1, &by_i, q.covariance);
    int is_rotating = fabs(creal(rate.value)) > SIGNIFICANT * sqrt(rate.covariance[0]);
    double larger = m->size[j] > m->size[i] ? m->size[j] : m->size[i];
    int near = cabs(q.value - (z[j] + z[i]) / 2) < FARTHEST * larger;
    q.flags = is_rotating && near && is_known(&q) ? DETERMINED : 0;
    return q;
}

/* Writes a quantity to the elements `at` of `values`, `covariances` of (2, 2) and `flags`. */
static void
store(const Quantity *q, long long at, Number *values, double *covariances, unsigned char *flags)
{
    double *covariance = covariances + 4 * at;
    values[at] = q->value;
    flags[at] = (unsigned char)q->flags;
    covariance[0] = q->covariance[0];
    covariance[1] = covariance[2] = q->covariance[1];
    covariance[3] = q->covariance[2];
}

Number
kinpole_arm(const Motion *m, long long t)
{
    return m->reference[t] * (cos(m->angle[t]) + I * sin(m->angle[t]));
}

void
kinpole_origins(const Motion *m, Number *origins)
{
    for (long long t = 0; t < m->poses; t++)
        origins[t] = m->position[t] - kinpole_arm(m, t);
}

void
kinpole_quantities(int quantity, const Motion *m, Number *values, double *covariances,
                   unsigned char *flags, unsigned char *reasons)
{
    for (long long t = 0; t < m->poses; t++) {
        Quantity q = kinpole_quantity(m, t, quantity);
        store(&q, t, values, covariances, flags);
        reasons[t] = (unsigned char)q.reason;
    }
}

void
kinpole_relative_centers(const Motion *m, long long bodies, const long long *pairs,
                         long long number, Number *values, double *covariances,
                         unsigned char *flags)
{
    for (long long t = 0; t < m->poses / bodies; t++)
        for (long long k = 0; k < number; k++) {
            long long j = t * bodies + pairs[k], i = t * bodies + pairs[number + k];
            Quantity q = kinpole_relative_center(m, j, i);
            store(&q, t * number + k, values, covariances, flags);
        }
}
