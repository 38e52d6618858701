#include <math.h>

#include "hub.h"
#include "memory.h"
#include "numbers.h"
#include "polynomials.h"

/* Log evidence that a hub has more than all models of the position: what its arm costs. */
#define ARM_COST 10.0
/* Turning exceeds that by the noise of the angle so many times, or there is no hub. */
#define MIN_TURNING 16.0
/* Most squares of the steps of the turning over those about its mean: white noise has 2. A body
   that turns there and back between two frames has 4, and some point is at one place in any two
   poses. */
#define MAX_STEPS 3.5
/* The polynomials of the last window without missing samples, of so many samples and with this
   instant: the next one may need the same. */
typedef struct {
    long long count;
    double at;
    Polynomials polynomials;
} KeptPolynomials;

/* The signals are both coordinates of the position, and from TURNED on cosine and sine of the
   angle, the turning. A complex number stands for two signals. */
enum { TURNED = 2 };

/* The complex number of two signals. */
static Number
pair_of(const double *pair)
{
    return pair[0] + I * pair[1];
}

/* Return the likeliest hub, by the degree of its path, from the fit `p` of the signals. `product`
   is the sum of conj(turning) times position, of what the polynomials leave of both. `radians` is
   the unit of the angle. `value` is -infinity where there is none. */
static Hub
likeliest_hub(const Polynomials *p, Number product, double radians)
{
    Hub best = {.value = -INFINITY}, by_degree[MAX_POLYNOMIALS];
    double path = p->left[0] + p->left[1], turning = p->left[2] + p->left[3];
    for (int d = MAX_POLYNOMIALS - 1; d >= 0; d--) {
        Hub *hub = by_degree + d, *higher = hub + MORE_DEGREES;
        *hub = (Hub){.turning = turning, .noise = (p->length - d - 1) * radians * radians};
        hub->arm = -product / (turning - hub->noise);
        hub->growth = 1 + square_of(hub->arm) * radians * radians;
        if (d + MORE_DEGREES < MAX_POLYNOMIALS && higher->noise > 0.0 &&
            higher->turning > MIN_TURNING * higher->noise) {
            double square = path + 2 * creal(conj(hub->arm) * product) +
                square_of(hub->arm) * turning;
            /* Mean and slope cost nothing, as those of the models. */
            double value = p->length * (1 - log(hub->growth)) - square / hub->growth / 2 -
                2 * d * COEFFICIENT_COST;
            if (value > best.value)
                best = *higher, best.degree = d, best.value = value;
        }
        Number position = pair_of(p->along[d]), turn = pair_of(p->along[d] + TURNED);
        path += square_of(position), turning += square_of(turn), product += conj(turn) * position;
    }
    return best;
}

/* Whether a body turns there and back between two frames. `turn` (2, count) are cosine and sine of
   its angle, of which `length` samples are not missing. */
static int
turns_within_frames(const Samples *s, double *const *turn, double length)
{
    Number sum = 0.0, last = 0.0;
    double steps = 0.0;
    int is_next = 0;
    for (long long t = 0; t < s->count; t++) {
        int is_there = s->weight[0][t] > 0.0 && s->weight[1][t] > 0.0;
        Number own = turn[0][t] + I * turn[1][t];
        if (is_there)
            sum += own, steps += is_next ? square_of(own - last) : 0.0;
        is_next = is_there, last = own;
    }
    return steps > MAX_STEPS * (length - square_of(sum) / length);
}

PRIVATE int
find_hub(Call *call, const Stencils *stencils, double radians, double least, Samples *s, Hub *hub)
{
    long long n = s->count;
    double length = 0.0, *root, *signal[4], *moved[2], at = stencils->at;
    int is_even = 1;
    KeptPolynomials *kept = kinpole_buffer(
        call, OF_HUB, sizeof *kept + (MAX_POLYNOMIALS + 6) * n * sizeof(double));
    if (!kept)
        return NO_MEMORY;
    char *data = (char *)(kept + 1);
    TAKE(root, MAX_POLYNOMIALS * n);
    for (int k = 0; k < 4; k++)
        TAKE(signal[k], n);
    TAKE(moved[0], n), TAKE(moved[1], n);
    for (long long t = 0; t < n; t++) {
        double angle = s->x[0][t] * radians, own = smaller(s->weight[0][t], s->weight[1][t]);
        is_even &= own == 1.0;
        own = sqrt(own), length += own > 0.0;
        signal[0][t] = own * s->x[1][t], signal[1][t] = own * s->x[2][t];
        moved[0][t] = cos(angle), moved[1][t] = sin(angle);
        signal[2][t] = own * moved[0][t], signal[3][t] = own * moved[1][t];
    }
    *hub = (Hub){.growth = 0.0};
    if (turns_within_frames(s, moved, length))
        return DONE;
    Polynomials *p = &kept->polynomials;
    if (!is_even || n != kept->count || at != kept->at) {
        for (long long t = 0; t < n; t++)
            root[t] = sqrt(smaller(s->weight[0][t], s->weight[1][t]));
        kept->count = is_even ? n : 0, kept->at = at;
        p->count = MAX_POLYNOMIALS, p->length = length;
        make_polynomials(root, n, -at, p);
    }
    fit_polynomials(root, n, signal[0], 4, p);
    Number product = dot(signal[2], signal[0], n) + dot(signal[3], signal[1], n) +
        I * (dot(signal[2], signal[1], n) - dot(signal[3], signal[0], n));
    *hub = likeliest_hub(p, product, radians);
    if (!(hub->value > least + ARM_COST)) {
        hub->growth = 0.0;
        return DONE;
    }
    for (long long t = 0; t < n; t++) {
        Number z = s->x[1][t] + I * s->x[2][t] + hub->arm * (moved[0][t] + I * moved[1][t]);
        moved[0][t] = creal(z) / sqrt(hub->growth), moved[1][t] = cimag(z) / sqrt(hub->growth);
    }
    s->x[1] = moved[0], s->x[2] = moved[1];
    double derivatives[MAX_ORDERS][MAX_POLYNOMIALS];
    differentiate_polynomials(p, n, stencils->orders, derivatives);
    for (int o = 0; o < stencils->orders; o++)
        for (int k = 0; k <= hub->degree; k++)
            hub->path[o] += derivatives[o][k] * pair_of(p->along[k] + TURNED);
    return DONE;
}

/* Compute exp(i angle) and its derivatives, into `out` (orders), of an angle with the derivatives
   `angle` (orders), in units of `radians`. */
static void
differentiate_turn(const double *angle, double radians, long long orders, Number *out)
{
    out[0] = cos(angle[0] * radians) + I * sin(angle[0] * radians);
    for (int n = 1; n < orders; n++) {
        double choose = 1.0;
        out[n] = 0.0;
        for (int k = 1; k <= n; k++) {
            out[n] += choose * angle[k] * radians * I * out[n - k];
            choose *= (n - k) / (double)k;
        }
    }
}

PRIVATE void
take_hub(const Hub *hub, const Estimate *moved, double radians, long long orders,
         Estimate *estimate)
{
    /* The turning that an error of the arm leaves to the hub, less the part that its path takes. */
    Number off[MAX_ORDERS];
    differentiate_turn(estimate->mean[0], radians, orders, off);
    estimate->hub = hub->arm;
    for (int o = 0; o < orders; o++) {
        off[o] -= hub->path[o];
        for (int c = 1; c < 3; c++)
            estimate->mean[c][o] = moved->mean[c][o] * sqrt(hub->growth);
        for (int q = 0; q <= o; q++)
            estimate->covariance[1][o][q] = estimate->covariance[1][q][o] = hub->growth *
                (moved->covariance[1][o][q] + creal(off[o] * conj(off[q])) / hub->turning);
    }
}
