/*
 * Poles, the velocity of the ICR and the curvature of the centrode with their covariances. The
 * formulas are those of _poles.py, _centrode.py and _uncertainty.py; test_figures.py compares both.
 * It is in C since the node needs them for few instants at a time, where numpy takes 50 calls each.
 */

#include <complex.h>
#include <math.h>

/* Complex products that do not check for infinities take a third of the time. */
#ifndef __clang__
#pragma GCC optimize("O3", "cx-limited-range")
#endif

#define HIGHEST 4
typedef double complex Number;
enum { VELOCITY = HIGHEST + 1, CURVATURE };

/* A quantity with its partial derivatives by the derivatives of position and angle. */
typedef struct {
    Number value, by_position[HIGHEST + 1], by_angle[HIGHEST + 1];
} Linear;

/* Adds to `moments` (xx, xy, yy) the covariance of sum(by * errors), 0 to `highest`. `errors` has
   shape (orders, orders); its elements are `step` apart. */
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

/* NaN for 0, as in numpy. */
static Number
inverse_of(Number number)
{
    return number == 0.0 ? NAN : 1.0 / number;
}

/* `turn` gets the rotation coefficient of that order and its derivatives by those of the angle. */
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

static void
velocity(const Number *z, const double *rate, Linear *out)
{
    Number q = -inverse_of(I * rate[1]), n = I * rate[2] * q, nv = n * z[1], iqq = I * q * q;
    Number inner = z[2] + nv;
    out->value = z[1] + q * inner;
    out->by_position[1] = 1.0 + n * q, out->by_position[2] = q;
    out->by_angle[1] = iqq * (inner + nv), out->by_angle[2] = iqq * z[1];
}

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
    out->value = cimag(g) * slowness;
}

/* Computes the pole of order 1 to 4, or VELOCITY or CURVATURE, at `count` instants. `position` and
   `angle` are (orders, count), their covariances (orders, orders, count). Writes `values` (count,),
   their covariances (count, 2, 2), and for poles the `significance` (count,): the size of the
   rotation coefficient over its standard deviation. */
#ifdef _WIN32
__declspec(dllexport)
#endif
void
kinpole_figures(int quantity, long long count, long long orders, const Number *position,
                const double *angle, const double *of_position, const double *of_angle,
                Number *values, double *covariances, double *significance)
{
    int highest = quantity > HIGHEST ? quantity - 3 : quantity;
    for (long long t = 0; t < count; t++) {
        double rate[HIGHEST + 1], by_turn[3] = {0}, by_angle[3] = {0}, by_position[3] = {0};
        double *covariance = covariances + 4 * t;
        Number z[HIGHEST + 1];
        Linear result = {0}, turn = {0};
        for (int k = 0; k <= highest; k++) {
            z[k] = position[k * count + t];
            rate[k] = angle[k * count + t];
        }
        if (quantity > HIGHEST)
            (quantity == VELOCITY ? velocity : curvature)(z, rate, &result);
        else {
            pole(quantity, z, rate, &turn, &result);
            add_moments(of_angle + t, orders, count, highest, turn.by_angle, by_turn);
            double square = creal(turn.value * conj(turn.value));
            significance[t] = sqrt(square / (by_turn[0] + by_turn[2]));
        }
        add_moments(of_angle + t, orders, count, highest, result.by_angle, by_angle);
        add_moments(of_position + t, orders, count, highest, result.by_position, by_position);
        /* The two coordinates of the position have independent errors of one covariance. */
        double isotropic = by_position[0] + by_position[2];
        covariance[0] = by_angle[0] + isotropic;
        covariance[1] = covariance[2] = by_angle[1];
        covariance[3] = by_angle[2] + isotropic;
        values[t] = result.value;
    }
}
