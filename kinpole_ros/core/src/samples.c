#include <math.h>
#include <string.h>

#include "samples.h"
#include "memory.h"
#include "numbers.h"

/* Information of at least this share of the largest is similar. Samples with this share of its
   mean, the usual one, get a weight of 1: a lower one costs time. */
#define SIMILAR_INFORMATION 0.5
/* A missing sample is first put on a parabola through so many others. */
#define PARABOLA_SAMPLES 6

PRIVATE double
mean_of_similar(const double *information, long long count)
{
    double best = 0.0, sum = 0.0, number = 0.0;
    for (long long k = 0; k < count; k++)
        best = larger(best, information[k]);
    for (long long k = 0; k < count; k++)
        if (information[k] >= SIMILAR_INFORMATION * best)
            sum += information[k], number += 1.0;
    return sum / number;
}

PRIVATE void
normalize_weights(double *weight, long long count, double usual)
{
    for (long long k = 0; k < count; k++) {
        weight[k] = usual > 0 ? weight[k] / usual : 0.0;
        weight[k] = weight[k] >= SIMILAR_INFORMATION ? 1.0 : weight[k];
    }
}

PRIVATE int
lay_out_samples(Call *call, int which, long long count, Samples *s)
{
    double *data = kinpole_buffer(call, which, 6 * count * sizeof(double));
    if (!data)
        return 0;
    memset(data, 0, 6 * count * sizeof(double));
    s->count = count;
    for (int c = 0; c < 3; c++)
        s->x[c] = data + c * count;
    s->weight[0] = data + 3 * count, s->weight[1] = data + 4 * count, s->off = data + 5 * count;
    return 1;
}

PRIVATE void
divide_samples(const Samples *s, const double *noise)
{
    for (int c = 0; c < 3; c++)
        for (long long k = 0; k < s->count; k++)
            s->x[c][k] /= noise[c > 0];
}

PRIVATE double
largest_sample(const Samples *s, int c)
{
    double most = 0.0;
    for (int d = c; d <= 2 * c; d++)
        for (long long k = 0; k < s->count; k++)
            most = larger(most, fabs(s->x[d][k]));
    return most;
}

PRIVATE void
fill_missing(const Samples *s)
{
    for (long long t = 0; t < s->count; t++) {
        if (s->weight[1][t] > 0)
            continue;
        /* Sums of powers of the places, and of the samples times these. */
        double m[5] = {0.0}, sums[3][3] = {{0.0}};
        int number = 0;
        for (long long step = 1; number < PARABOLA_SAMPLES && step < s->count; step++)
            for (int side = -1; side <= 1 && number < PARABOLA_SAMPLES; side += 2) {
                long long k = t + side * step;
                if (k < 0 || k >= s->count || !(s->weight[1][k] > 0))
                    continue;
                double place = (side * step + s->off[k]) / PARABOLA_SAMPLES, power = 1.0;
                for (int n = 0; n < 5; n++, power *= place) {
                    m[n] += power;
                    for (int c = 0; c < 3 && n < 3; c++)
                        sums[c][n] += power * s->x[c][k];
                }
                number++;
            }
        /* The value of the parabola at the place of the sample, by Cramer's rule. */
        double a = m[2] * m[4] - m[3] * m[3], b = m[2] * m[3] - m[1] * m[4];
        double d = m[1] * m[3] - m[2] * m[2], det = m[0] * a + m[1] * b + m[2] * d;
        for (int c = 0; c < 3; c++)
            s->x[c][t] = (a * sums[c][0] + b * sums[c][1] + d * sums[c][2]) / det;
    }
}

PRIVATE void
move_by_neighbors(const Samples *s, double *const moved[3])
{
    long long n = s->count;
    for (int c = 0; c < 3; c++)
        for (long long k = 0; k < n; k++) {
            const double *y = s->x[c];
            long long low = k > 0 ? k - 1 : 0, high = k < n - 1 ? k + 1 : n - 1;
            double before = k + s->off[k] - low - s->off[low];
            double after = high + s->off[high] - k - s->off[k];
            double first = (y[k] - y[low]) / before, second = (y[high] - y[k]) / after;
            double at = s->off[k];
            double bend = (second - first) / (before + after);
            if (k == 0 || k == n - 1)
                moved[c][k] = y[k] - at * (k ? first : second);
            else
                moved[c][k] = y[k] - (at * (first + bend * before) - at * at * bend);
        }
}
