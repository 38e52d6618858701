#include <math.h>
#include <stddef.h>
#include <string.h>

#include "events.h"
#include "evidence.h"
#include "memory.h"
#include "numbers.h"

/* Standard deviation of an event's place, samples: an event lies between two samples. By how well
   the samples show the place, up to 3, errors and coverage are the same. */
#define PLACE_SIGMA 0.5

/* Set the prior standard deviations of the columns of an event, `root` of the set, with `weight` 1,
   for the angle or the position, to the sizes that its screen estimates, of each alone; 0 if
   nothing is left of a column. That of the shift in time is the size of the step times the standard
   deviation of its place. */
static void
estimate_prior_sizes(const Models *m, const Screen *screen, const Candidate *event, Set *set)
{
    long long first = screen->c * set->columns + set->low_samples;
    double *weight = set->weight + first, *root = set->root + first;
    for (int k = 0; k < set->steps; k++) {
        long long at = set->step[k].order * m->count + event->sample;
        double square = screen->step_squares[at];
        double size = screen->squared_products[at] / (screen->c + 1);
        /* No size is below its standard deviation, where it might be rounding. */
        root[k] = square < INFINITY ? sqrt(larger(size, square)) / square : 0.0;
        if (set->step[k].order < event->order)
            root[k] = root[0] * PLACE_SIGMA;
        weight[k] = 1.0;
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
    if (event->order + 1 < STEP_ORDERS)
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
        estimate_prior_sizes(m, screens->signal + c, event, set);
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
        for (long long x = 0; x < set->low_samples; x++) {
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
    int order = set->step[0].order;
    long long n = m->count, orders = stencils->orders, edge = edge_of(order);
    long long places = n - 2 * edge + 1, best = 0;
    double *weight = scratch, *sums = scratch + n, total = 0.0;
    const double *gain = screens->gain + order * n + edge;
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
                long long k = i < 0 ? best : i, at = order * n + k + edge;
                double since = stencils->at - (k + edge - 0.5);
                double off[MAX_ORDERS], size;
                size = screen->step_products[j * STEP_ORDERS * n + at] / screen->step_squares[at];
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
    Candidate event = screen_window(m, s, w, sets, &screens);
    if (!(event.gain >= EVENT_COST))
        return DONE;
    Set *set = sets + (*number)++;
    add_event(m, sets, &screens, &event, orders, block, data, set);
    add_place_covariance(m, stencils, sets, &screens, w->column_products, scratch, set);
    evaluate_models(m, s, w, set);
    return DONE;
}
