/*
 * Poles, the velocity of the ICR and the curvature of the centrode, with their covariances, of one
 * instant after the other: numpy takes 50 calls for each of them, however few instants there are.
 * The formulas are those of _poles.py, _centrode.py and _linear.py, which test_figures.py holds
 * them against.
 */

#include <complex.h>
#include <math.h>

/* Products without a look at infinities, as numpy's: a third of the time. */
#ifndef __clang__
#pragma GCC optimize("O3", "cx-limited-range")
#endif

#define HIGHEST 4
typedef double complex Number;
enum { VELOCITY = HIGHEST + 1, CURVATURE };

/* A figure, and its derivatives by each of those of the position and of the angle. */
typedef struct {
    Number value, by_position[HIGHEST + 1], by_angle[HIGHEST + 1];
} Linear;

/* Mean products of the parts x and y of the sum of factors times errors: xx, xy and yy. Covariances
   of the errors (K, K) are `step` apart, and the last factor is that of `highest`. */
static void
products(const double *errors, long long orders, long long step, int highest, const Number *by, double *mean)
{
    mean[0] = mean[1] = mean[2] = 0.0;
    for (int k = 0; k <= highest; k++) {
        double x = 0.0, y = 0.0;
        for (int l = 0; by[k] != 0.0 && l <= highest; l++) {
            double error = errors[(k * orders + l) * step];
            x += error * creal(by[l]), y += error * cimag(by[l]);
        }
        mean[0] += creal(by[k]) * x, mean[1] += creal(by[k]) * y, mean[2] += cimag(by[k]) * y;
    }
}

/* As in numpy, not a number for 0. */
static Number
inverse_of(Number number)
{
    return number == 0.0 ? NAN : 1.0 / number;
}

/* `turn` gets the coefficient of the turn, and its derivatives by those of the angle. */
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
    /* Of the acceleration. */
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

/* A pole of the order `what`, 1 to 4, or 5 or 6 of the enum above, at `count` instants. Position and
   angle are (orders, count) with covariances (orders, orders, count); `values` (count,) are complex,
   `spreads` (count, 2, 2) their covariances, and `sure` (count,) is how sure the turn is. */
#ifdef _WIN32
__declspec(dllexport)
#endif
void
kinpole_figures(int what, long long count, long long orders, const Number *position,
                const double *angle, const double *of_position, const double *of_angle,
                Number *values, double *spreads, double *sure)
{
    int highest = what > HIGHEST ? what - 3 : what;
    for (long long t = 0; t < count; t++) {
        double rate[HIGHEST + 1], mean[3], *spread = spreads + 4 * t;
        Number z[HIGHEST + 1];
        Linear found = {0}, turn = {0};
        for (int k = 0; k <= highest; k++) {
            z[k] = position[k * count + t];
            rate[k] = angle[k * count + t];
        }
        if (what > HIGHEST)
            (what == VELOCITY ? velocity : curvature)(z, rate, &found);
        else {
            pole(what, z, rate, &turn, &found);
            products(of_angle + t, orders, count, highest, turn.by_angle, mean);
            double square = creal(turn.value * conj(turn.value));
            sure[t] = sqrt(square / (mean[0] + mean[2]));
        }
        products(of_angle + t, orders, count, highest, found.by_angle, mean);
        spread[0] = mean[0], spread[1] = spread[2] = mean[1], spread[3] = mean[2];
        products(of_position + t, orders, count, highest, found.by_position, mean);
        spread[0] += mean[0] + mean[2], spread[3] += mean[0] + mean[2];
        values[t] = found.value;
    }
}
