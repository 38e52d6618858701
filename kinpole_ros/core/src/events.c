#include <math.h>
#include <stddef.h>
#include <string.h>

#include "events.h"
#include "evidence.h"
#include "memory.h"
#include "numbers.h"

/* Log evidence that a candidate has to add in the screening: less than it costs, since other models
   may gain more by it than the one that screens. */
#define MIN_GAIN 8.0
/* Standard deviation of an event's place, samples: an event lies between two samples. By how well
   the samples show the place, up to 3, errors and coverage are the same. */
#define PLACE_SIGMA 0.5

/* Compute what a screen leaves of the columns of a new event, the steps of a set: their `products`
   (steps, steps) with each other, below the diagonal; their `squares` (steps) without the screen;
   and their products `with_residual` (c + 1, steps) with the residual of the signals. */
static void
find_event_products(const Models *m, const Screen *screen, Set *set,
                    double products[][EVENT_COLUMNS], double *squares,
                    double with_residual[][EVENT_COLUMNS])
{
    long long n = m->count, number = set->steps, group = screen->model / LANES;
    const double *columns = set->step_columns;
    const double *coefficients = set->coefficients + set->low_samples * m->rows;
    const double *shrinkage =
        (const double *)(m->shrinkage + group % m->chunks * m->rows) + screen->model % LANES;
    project_steps(m, group / m->chunks, set);
    for (int k = 0; k < number; k++) {
        for (int l = 0; l <= k; l++)
            products[k][l] = dot(columns + k * n, columns + l * n, n);
        squares[k] = products[k][k];
        for (int j = 0; j <= screen->c; j++)
            with_residual[j][k] = dot(columns + k * n, screen->residual + j * n, n);
    }
    for (int parity = 0; parity < 2; parity++) {
        const long long *first = m->first_row + parity * (m->processes + 1) + group / m->chunks;
        for (long long r = first[0]; r < first[1]; r++)
            for (int k = 0; k < number; k++)
                for (int l = 0; l <= k; l++)
                    products[k][l] -= shrinkage[r * LANES] * coefficients[k * m->rows + r] *
                        coefficients[l * m->rows + r];
    }
    for (long long x = 0; x < screen->columns; x++) {
        double by[EVENT_COLUMNS];
        for (int k = 0; k < number; k++)
            by[k] = dot(columns + k * n, screen->reduced_columns + x * n, n);
        for (int k = 0; k < number; k++)
            for (int l = 0; l <= k; l++)
                products[k][l] -= screen->factor[x] * by[k] * by[l];
    }
}

/* Set the prior standard deviations of the columns of an event of this order, `root` of the set,
   with `weight` 1, for the angle or the position, to the sizes that its screen estimates, each
   after the columns before it are removed; 0 if nothing is left of a column. That of the shift in
   time is the size of the step times the standard deviation of its place. */
static void
estimate_prior_sizes(const Models *m, const Screen *screen, Set *set, int order)
{
    long long number = set->steps, c = screen->c, first = c * set->columns + set->low_samples;
    double *weight = set->weight + first, *root = set->root + first;
    double products[EVENT_COLUMNS][EVENT_COLUMNS], squares[EVENT_COLUMNS];
    double with_residual[2][EVENT_COLUMNS];
    find_event_products(m, screen, set, products, squares, with_residual);
    for (int k = 0; k < number; k++) {
        double square = products[k][k], size = 0.0;
        if (!(square > MIN_STEP_LEFT * MIN_STEP_LEFT * squares[k]))
            square = 0.0;
        for (int j = 0; j <= c; j++)
            size += with_residual[j][k] * with_residual[j][k] / (c + 1);
        /* No size is below its standard deviation, where it might be rounding. */
        root[k] = square > 0.0 ? sqrt(larger(size, square)) / square : 0.0;
        if (set->step[k].order == order - 1)
            root[k] = root[0] * PLACE_SIGMA;
        weight[k] = 1.0;
        double factor = root[k] * root[k] / (1.0 + root[k] * root[k] * square);
        for (int l = k + 1; l < number; l++) {
            for (int i = k + 1; i <= l; i++)
                products[l][i] -= factor * products[l][k] * products[i][k];
            for (int j = 0; j <= c; j++)
                with_residual[j][l] -= factor * products[l][k] * with_residual[j][k];
        }
    }
}

/* Make a set with the columns of an event besides those of `none`: its step, a step of the
   derivative below, for its shift in time, and of the one above. Samples are means of `block`
   cells. The set is laid out at `data` for so many `orders`. */
static void
add_event(const Models *m, const Set *none, const Screens *screens, const Candidate *event,
          long long orders, long long block, char *data, Set *set)
{
    long long n = m->count, low = none->low_samples, steps = 1;
    /* The shift in time needs the size of the step, so the step is the first. */
    int order[EVENT_COLUMNS] = {event->order};
    if (event->order)
        order[steps++] = event->order - 1;
    order[steps++] = event->order + 1;
    lay_out_set(m, orders, low + steps, steps, 2, data, set);
    set->low_samples = low, set->steps = steps;
    set->log_prior = -EVENT_COST;
    memcpy(set->low_sample, none->low_sample, low * sizeof *set->low_sample);
    memcpy(set->coefficients, none->coefficients, low * m->rows * sizeof(double));
    for (int part = 0; part < 2; part++) {
        long long old = part < none->parts ? part * low : 0;
        memcpy(set->weight + part * set->columns, none->weight + old, low * sizeof(double));
        memcpy(set->root + part * set->columns, none->root + old, low * sizeof(double));
    }
    double *signals[EVENT_COLUMNS];
    for (int k = 0; k < steps; k++) {
        signals[k] = set->step_columns + k * n;
        set->step[k] = (Step){.place = event->sample - 0.5, .order = order[k]};
        fill_step_column(set->step + k, n, block, signals[k]);
    }
    fold(m, signals, steps, set->folded);
    for (int c = 0; c < 2; c++)
        estimate_prior_sizes(m, screens->signal + c, set, event->order);
}

/* Compute the `sample_weights` of screens, by their models with the samples of low weight of a set.
   `lanes` (half) is memory. */
static void
find_sample_weights(const Models *m, const Stencils *stencils, const Set *set, Lanes *lanes,
                    Screens *screens)
{
    long long n = m->count, orders = stencils->orders;
    double *weights = screens->sample_weights;
    memset(weights, 0, 2 * orders * n * sizeof(double));
    for (long long k = 0; k < 2 * orders; k++, weights += n) {
        const Screen *screen = screens->signal + k / orders;
        /* From a signal of zeros, so these are minus the weights. */
        subtract_model(m, screen->model, stencils->modes + k % orders * m->rows, weights, lanes,
                       weights);
        for (long long x = 0; x < screen->columns; x++) {
            double change = weights[set->low_sample[x]] * screen->factor[x];
            for (long long t = 0; t < n; t++)
                weights[t] -= change * screen->reduced_columns[x * n + t];
        }
    }
}

/* Add to a set the covariance of derivatives from the place of its event: the weighted mean, over
   the places k, of d d'. Here d is the difference of the derivatives with the event at k from those
   with it at the best place. Weights are powers of the evidence. Nothing is added if all places
   that count are far from the instant. `lanes` (half) and `scratch` (1 + STEP_ORDERS orders, count)
   are memory. */
static void
add_place_covariance(const Models *m, const Stencils *stencils, const Set *none, Screens *screens,
                     Lanes *lanes, double *scratch, Set *set)
{
    long long n = m->count, orders = stencils->orders, places = n - 2 * EDGE_SAMPLES + 1, best = 0;
    int order = set->step[0].order;
    double *weight = scratch, *sums = scratch + n, total = 0.0;
    const double *gain = screens->gain + order * n + EDGE_SAMPLES;
    for (long long k = 0; k < places; k++)
        best = gain[k] > gain[best] ? k : best;
    for (long long k = 0; k < places; k++) {
        weight[k] = exp(PLACE_POWER * (gain[k] - gain[best]));
        total += weight[k];
    }
    find_sample_weights(m, stencils, none, lanes, screens);
    for (int c = 0; c < 2; c++) {
        const Screen *screen = screens->signal + c;
        for (long long o = 0; o < orders; o++)
            sum_products_with_steps(screens->sample_weights + (c * orders + o) * n, n,
                                    sums + o * STEP_ORDERS * n);
        for (int j = 0; j <= c; j++) {
            double with_best[MAX_ORDERS] = {0.0};
            /* The best place comes first, as the origin of the differences. */
            for (long long i = -1; i < places; i++) {
                long long k = i < 0 ? best : i, at = order * n + k + EDGE_SAMPLES;
                double since = stencils->at - (k + EDGE_SAMPLES - 0.5);
                double off[MAX_ORDERS], ratio, size;
                explained_squares(screen, at, &ratio);
                size = screen->step_products[j * STEP_ORDERS * n + at] / screen->step_squares[at] *
                    ratio / (1 + ratio);
                for (long long o = 0; o < orders; o++) {
                    double here = o > order ? 0.0 : step_value(order - o, since);
                    off[o] = size * (here + sums[o * STEP_ORDERS * n + at]) - with_best[o];
                }
                if (i < 0)
                    memcpy(with_best, off, sizeof with_best);
                for (long long o = 0; o < orders; o++)
                    for (long long p = 0; p < (i < 0 ? 0 : orders); p++)
                        set->place_covariance[c][o][p] +=
                            weight[k] / total / (c + 1) * off[o] * off[p];
            }
        }
    }
}

PRIVATE int
search_events(Call *call, const Models *m, const Stencils *stencils, const Samples *s,
              const Work *w, long long block, Set *sets, int *number)
{
    long long low = sets->low_samples, n = m->count, orders = stencils->orders;
    size_t of_set = size_of_set(m, orders, low + EVENT_COLUMNS, EVENT_COLUMNS, 2);
    size_t of_screens = 2 * ((2 + 4 * STEP_ORDERS + low) * n + low) + STEP_ORDERS * n +
        2 * orders * n;
    size_t of_scratch = (1 + STEP_ORDERS * MAX_ORDERS) * n;
    char *data =
        kinpole_buffer(call, OF_SETS, (of_scratch + of_screens) * sizeof(double) + of_set);
    if (!data)
        return NO_MEMORY;
    Screens screens;
    double *scratch;
    TAKE(scratch, (1 + STEP_ORDERS * MAX_ORDERS) * n);
    data = lay_out_screens(n, orders, low, data, &screens);
    Candidate event = screen_window(m, s, w, sets, scratch, &screens);
    if (!(event.gain >= MIN_GAIN))
        return DONE;
    Set *set = sets + (*number)++;
    add_event(m, sets, &screens, &event, orders, block, data, set);
    add_place_covariance(m, stencils, sets, &screens, w->column_products, scratch, set);
    evaluate_models(m, s, w, set);
    return DONE;
}
