/*
 * Events: instants at which the position, the velocity or the acceleration steps, as at an impact.
 *
 * 1. Screening. One model leaves the residual P x of the samples x, with the inverse P of its
 *    covariance. A step b, half a sample before each sample, has the product b' P x, and its size
 *    is estimated as b' P x / b' P b. The products of all steps are cumulative sums of P x. They
 *    give the evidence that a step of each order at each place would add (`find_candidates`). This
 *    is done with the most probable model, and with the most probable slow one, which leaves steps
 *    in its residual.
 * 2. Evaluation. The best candidate of each order becomes columns of the regression: the step, its
 *    shift in time, and a step of the next derivative. All models are evaluated with them
 *    (`add_event`, `evaluate_models`).
 * 3. A second event is screened with the first one in place, and then evaluated.
 * 4. Other places of an event, by their evidence, add to the covariance (`add_place_covariance`).
 *
 * `search_events` returns the sets, and `differentiate` averages all models with all of them. The
 * evidence of a set less that of the first set, without events, says how sure its events are.
 *
 * _events.py detects the events that are reported. It has polynomials instead of these models, and
 * excludes what only looks like an event. Both have the same columns of steps and nothing more.
 */

/* Orders of derivatives that may step: position, velocity and acceleration. */
#define STEP_ORDERS 3
/* Columns of an event: the step, its shift in time, and a step of the next derivative. */
#define EVENT_COLUMNS 3
/* Windows are searched if their best evidence is below that of a line by this many log widths of
   the flat prior. With 1 the errors are the same, and the search takes a sixth longer. */
#define SEARCH_BELOW 3
/* Prior probability that a window has an event: events are rare. */
#define EVENT_PRIOR 0.05
/* Cost of a size in log evidence: the prior of sizes is wider than the size that is estimated. */
#define SIZE_COST 2.4
/* Log evidence that a candidate has to add in the screening: below it the prior wins. */
#define MIN_GAIN 8.0
/* Log evidence by which a candidate of another order may be behind the best one. */
#define MAX_EVIDENCE_BEHIND 3.0
/* Log evidence of a second event above which the set without it has no weight. */
#define CERTAIN_GAIN 25.0
/* Samples between an event and the ends of the window, so that both sides are seen. */
#define EDGE_SAMPLES 3
/* Bounds of the standard deviation of an event's place, samples: an event lies between two samples,
   and its shift is linear over few. */
#define MIN_PLACE_SIGMA 0.5
#define MAX_PLACE_SIGMA 3.0
/* Power of the evidence by which other places count in the covariance. A step may be a ramp, which
   no model of steps has. With 1/2, 10.5% of the cells cover less than 85%; with 1/4, 8.7%. */
#define PLACE_EVIDENCE_POWER 0.25
/* Places whose chance is below exp(-this) of the best do not count: less than 0.1%. */
#define MAX_LOG_CHANCE 7.0
/* Other places count if one of them is this close to the instant, samples: farther events change
   derivatives by less than their standard deviation. */
#define NEAR_SAMPLES 12
/* Lengths of each spectrum that count as slow; slow models leave steps in the residuals. */
#define SLOW_LENGTHS 2
/* A step of which the columns leave less than this share is already in the set. */
#define MIN_STEP_LEFT 1e-6

/* What one model with the columns of a set leaves of the angle (c = 0), or of the position (c = 1).
   P is that of the model less the sum of factor r r' of the reduced columns r. */
typedef struct {
    int c;
    long long model, columns;
    double residual_squares;  /* x' P x */
    double *residual;         /* (c + 1, count): P x */
    double *step_products;    /* (c + 1, STEP_ORDERS, count): b' P x */
    double *squared_products; /* (STEP_ORDERS, count): their squares, summed over coordinates */
    double *step_squares;     /* (STEP_ORDERS, count): b' P b, infinite if it is rounding */
    double *reduced_columns;  /* (columns, count): P b with the P before this column */
    double *factor;           /* (columns) */
} Screen;

/* The screens of angle and position. */
typedef struct {
    Screen signal[2];
    double *gain; /* (STEP_ORDERS, count): log evidence that a step adds, without SIZE_COST */
    double *sample_weights; /* (2, orders, count): of the samples in the derivatives */
    int has_sample_weights;
} Screens;

/* An event half a sample before `sample`: the log evidence with it, and what it adds to that. */
typedef struct {
    double value, gain;
    long long sample;
    int order;
    Screens *screens;
} Candidate;

/* Return the number of the most probable model of a set, or of its slow models. */
static long long
most_probable_model(const Models *m, const Set *set, int c, int slow)
{
    const double *evidence = (const double *)(set->evidence + c * m->groups);
    long long process = m->chunks * LANES, best = 0;
    for (long long k = 0; k < m->groups * LANES; k++) {
        long long spectrum = m->spectrum[k], slower = k - SLOW_LENGTHS * process;
        /* Processes of a spectrum begin with the longest. */
        int is_fast = slower >= 0 && m->spectrum[slower] == spectrum;
        int is_allowed = slow ? spectrum < m->spectra - 1 && !is_fast : spectrum != m->spectra - 1;
        if (is_allowed && evidence[k] > evidence[best])
            best = k;
    }
    return best;
}

/* Compute the residual P x (count) that a model leaves of a signal x with these coefficients. */
static void
subtract_model(const Models *m, long long model, const double *coefficients, const double *signal,
               Lanes *sums, double *residual)
{
    long long group = model / LANES, lane = model % LANES, n = m->count;
    const double *shrinkage = (const double *)(m->shrinkage + group % m->chunks * m->rows) + lane;
    const long long *first = m->first_row + group / m->chunks;
    memcpy(residual, signal, n * sizeof(double));
    for (int parity = 0; parity < 2; parity++, first += m->processes + 1) {
        memset(sums, 0, m->half * sizeof(Lanes));
        for (long long r = first[0] / LANES * LANES; r < first[1]; r += LANES) {
            Lanes factor = all_lanes(0.0);
            for (long long k = r > first[0] ? r : first[0]; k < r + LANES && k < first[1]; k++)
                ((double *)&factor)[k - r] = shrinkage[k * LANES] * coefficients[k];
            for (long long t = 0; t < m->half; t++)
                sums[t] = multiply_add(sums[t], factor, m->basis[r / LANES * m->half + t]);
        }
        for (long long t = 0; t < m->half; t++) {
            double sum = sum_of(sums[t]);
            residual[t] -= t == n - 1 - t ? 2 * sum : sum;
            if (t != n - 1 - t)
                residual[n - 1 - t] -= parity ? -sum : sum;
        }
    }
}

/* Add a column b (count) with these coefficients to a screen, if the screen leaves any of it: P is
   reduced by the matrix inversion lemma. */
static void
add_column(const Models *m, const Samples *s, const double *column, const double *coefficients,
           double weight, double root, Lanes *sums, Screen *screen)
{
    long long n = m->count;
    double *reduced = screen->reduced_columns + screen->columns * n;
    subtract_model(m, screen->model, coefficients, column, sums, reduced);
    for (long long k = 0; k < screen->columns; k++) {
        const double *other = screen->reduced_columns + k * n;
        double by = screen->factor[k] * dot(other, column, n);
        for (long long t = 0; t < n; t++)
            reduced[t] -= by * other[t];
    }
    double square = dot(column, reduced, n);
    if (!(square > MIN_STEP_LEFT * MIN_STEP_LEFT * dot(column, column, n)))
        square = 0.0;
    double factor = root > 0.0 ? root * root / (weight + root * root * square) : 0.0;
    for (int j = 0; j <= screen->c; j++) {
        double by = factor * dot(reduced, s->x[screen->c + j], n);
        for (long long t = 0; t < n; t++)
            screen->residual[j * n + t] -= by * reduced[t];
    }
    screen->factor[screen->columns++] = factor;
}

/* Compute the products (STEP_ORDERS, count) of a signal with steps half a sample before each one.
   Those with (t + 1/2)^k / k! follow from repeated cumulative sums, in one pass. */
static void
sum_products_with_steps(const double *signal, long long count, double *sums)
{
    double a = 0.0, b = 0.0, c = 0.0;
    for (long long k = count - 1; k >= 0; k--) {
        c += b, b += a, a += signal[k];
        sums[k] = a;
        sums[count + k] = b + a / 2;
        sums[2 * count + k] = c + b + a / 8;
    }
}

/* Add the new columns of a set to a screen, and screen steps at all places. */
static void
screen_steps(const Models *m, const Samples *s, const Work *w, const Set *set, double *scratch,
             Screen *screen)
{
    long long n = m->count, part = set->parts > 1 && screen->c > 0;
    const double *of_model = m->step_squares + screen->model * STEP_ORDERS * n;
    for (long long x = screen->columns; x < set->columns; x++) {
        const double *column = scratch;
        long long at = part * set->columns + x;
        if (x < set->cells)
            memset(scratch, 0, n * sizeof(double)), scratch[set->cell[x]] = 1.0;
        else
            column = set->step_columns + (x - set->cells) * n;
        add_column(m, s, column, set->coefficients + x * m->rows, set->weight[at], set->root[at],
                   w->column_products, screen);
        double *products = screen->squared_products; /* free until the columns are added */
        sum_products_with_steps(screen->reduced_columns + x * n, n, products);
        for (long long k = 0; k < STEP_ORDERS * n; k++)
            screen->step_squares[k] -= screen->factor[x] * products[k] * products[k];
    }
    memset(screen->squared_products, 0, STEP_ORDERS * n * sizeof(double));
    screen->residual_squares = 0.0;
    for (int j = 0; j <= screen->c; j++) {
        screen->residual_squares += dot(screen->residual + j * n, s->x[screen->c + j], n);
        double *products = screen->step_products + j * STEP_ORDERS * n;
        sum_products_with_steps(screen->residual + j * n, n, products);
        for (long long k = 0; k < STEP_ORDERS * n; k++)
            screen->squared_products[k] += products[k] * products[k];
    }
    screen->residual_squares = larger(screen->residual_squares, 0.0);
    for (long long k = 0; k < STEP_ORDERS * n; k++)
        if (!(screen->step_squares[k] > MIN_STEP_LEFT * of_model[k]))
            screen->step_squares[k] = INFINITY;
}

/* Begin a screen with a model, without columns. */
static void
begin_screen(const Models *m, const Samples *s, const Work *w, long long model, Screen *screen)
{
    long long n = m->count;
    screen->model = model, screen->columns = 0;
    for (int j = 0; j <= screen->c; j++)
        subtract_model(m, model, w->coefficients + (screen->c + j) * m->rows, s->x[screen->c + j],
                       w->column_products, screen->residual + j * n);
    memcpy(screen->step_squares, m->step_squares + model * STEP_ORDERS * n,
           STEP_ORDERS * n * sizeof(double));
}

/* Return by how much a step reduces the residual sum of squares, if the prior variance of its size
   is the square of the estimate. `ratio` is that square over the variance of the estimate. */
static inline double
explained_squares(const Screen *screen, long long k, double *ratio)
{
    *ratio = screen->squared_products[k] / screen->step_squares[k] / (screen->c + 1);
    return (screen->c + 1) * *ratio * *ratio / (1 + *ratio);
}

/* Return the log evidence that such a step adds. */
static double
evidence_gain(const Screen *screen, const Work *w, long long k)
{
    double ratio, explained = explained_squares(screen, k, &ratio);
    double before = screen->residual_squares + w->prior_samples;
    double number = w->prior_samples + w->total_weight[screen->c] * (screen->c + 1);
    double after = larger(before - explained, w->prior_samples);
    return larger(number / 2 * log(before / after) - (screen->c + 1) * log(1 + ratio) / 2, 0.0);
}

/* Find the best place of a step of each order, if it is better than that in `best`. `value` is the
   log evidence without the step. The gain of a place is without the cost of the size, and has the
   approximation z (6 - z) / (6 - 4 z) of -log(1 - z), because there are many places. */
static void
find_candidates(const Models *m, const Work *w, double value, Screens *screens, Candidate *best)
{
    long long n = m->count;
    memset(screens->gain, 0, STEP_ORDERS * n * sizeof(double));
    for (int c = 0; c < 2; c++) {
        const Screen *screen = screens->signal + c;
        double per = 1 / (c + 1.0), all = 1 / (screen->residual_squares + w->prior_samples);
        double number = (w->prior_samples + w->total_weight[c] * (c + 1)) / 2;
        for (long long k = 0; k < STEP_ORDERS * n; k++) {
            double ratio = screen->squared_products[k] / screen->step_squares[k] * per;
            double z = smaller((c + 1) * all * ratio * ratio / (1 + ratio), 1.0);
            screens->gain[k] += number * z * (6 - z) / (6 - 4 * z);
        }
    }
    for (int order = 0; order < STEP_ORDERS; order++) {
        long long at = order * n + EDGE_SAMPLES;
        for (long long k = at; k <= (order + 1) * n - EDGE_SAMPLES; k++)
            if (screens->gain[k] > screens->gain[at])
                at = k;
        double gain = evidence_gain(screens->signal, w, at) +
                      evidence_gain(screens->signal + 1, w, at);
        Candidate one = {value + gain, gain, at - order * n, order, screens};
        if (one.value > best[order].value)
            best[order] = one;
    }
}

static const Candidate *
best_candidate(const Candidate *candidates)
{
    const Candidate *best = candidates;
    for (int k = 1; k < STEP_ORDERS; k++)
        best = candidates[k].value > best->value ? candidates + k : best;
    return best;
}

/* Compute what a screen leaves of the columns of a new event: their products with each other, of
   which `squares` are those without the screen, and with the residual of the signal. */
static void
find_event_products(const Models *m, const Screen *screen, Set *set, long long begin,
                    double products[][EVENT_COLUMNS], double *squares,
                    double with_residual[][EVENT_COLUMNS])
{
    long long n = m->count, number = set->steps - begin, group = screen->model / LANES;
    const double *columns = set->step_columns + begin * n;
    const double *coefficients = set->coefficients + (set->cells + begin) * m->rows;
    const double *shrinkage = (const double *)(m->shrinkage) + screen->model % LANES;
    project_steps(m, group, set);
    for (int k = 0; k < number; k++) {
        for (int l = 0; l <= k; l++)
            products[k][l] = dot(columns + k * n, columns + l * n, n);
        squares[k] = products[k][k];
        for (int j = 0; j <= screen->c; j++)
            with_residual[j][k] = dot(columns + k * n, screen->residual + j * n, n);
    }
    for (int parity = 0; parity < 2; parity++) {
        const long long *first = m->first_row + parity * (m->processes + 1) + group;
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

/* Set the prior standard deviations of the columns of a new event, from the step `begin` on, to the
   sizes that a screen estimates, each after the columns before it are removed. That of the shift in
   time is the size of the step times the standard deviation of its place. */
static void
estimate_sizes(const Models *m, const Screen *screen, Set *set, long long begin, int order)
{
    long long number = set->steps - begin, c = screen->c;
    long long first = c * set->columns + set->cells + begin;
    double *weight = set->weight + first, *root = set->root + first;
    double products[EVENT_COLUMNS][EVENT_COLUMNS], squares[EVENT_COLUMNS];
    double with_residual[2][EVENT_COLUMNS];
    find_event_products(m, screen, set, begin, products, squares, with_residual);
    for (int k = 0; k < number; k++) {
        double square = products[k][k], size = 0.0;
        if (!(square > MIN_STEP_LEFT * MIN_STEP_LEFT * squares[k]))
            square = 0.0;
        for (int j = 0; j <= c; j++)
            size += with_residual[j][k] * with_residual[j][k] / (c + 1);
        /* No size is below its standard deviation, where it might be rounding. */
        root[k] = square > 0.0 ? sqrt(larger(size, square)) / square : 0.0;
        if (set->step[begin + k].order == order - 1) {
            double ratio = root[0] * sqrt((c + 1) * square), place = MIN_PLACE_SIGMA;
            if (ratio > 0.0)
                place = smaller(larger(1 / ratio, MIN_PLACE_SIGMA), MAX_PLACE_SIGMA);
            root[k] = root[0] * place;
        }
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

/* Copy a set, and add the columns of an event. The new set is laid out at `data`; returns the end
   of its memory. */
static char *
add_event(const Models *m, const Set *from, const Candidate *event, long long orders,
          long long block, char *data, Set *set)
{
    long long n = m->count, cells = from->cells, begin = from->steps, number = 1;
    /* The shift in time needs the size of the step, so the step is the first. */
    int order[EVENT_COLUMNS] = {event->order};
    if (event->order)
        order[number++] = event->order - 1;
    order[number++] = event->order + 1;
    long long steps = begin + number, columns = cells + steps;
    data = lay_out_set(m, orders, columns, steps, 2, data, set);
    set->cells = cells, set->steps = steps, set->events = from->events + 1;
    set->log_prior =
        from->log_prior + log(EVENT_PRIOR / (1 - EVENT_PRIOR) / (STEP_ORDERS * n)) - SIZE_COST;
    memcpy(set->cell, from->cell, cells * sizeof *set->cell);
    memcpy(set->step, from->step, sizeof set->step);
    memcpy(set->place_covariance, from->place_covariance, sizeof set->place_covariance);
    memcpy(set->step_columns, from->step_columns, begin * n * sizeof(double));
    memcpy(set->coefficients, from->coefficients, from->columns * m->rows * sizeof(double));
    for (int part = 0; part < 2; part++) {
        long long old = part < from->parts ? part * from->columns : 0;
        memcpy(set->weight + part * columns, from->weight + old, from->columns * sizeof(double));
        memcpy(set->root + part * columns, from->root + old, from->columns * sizeof(double));
    }
    double *signals[MAX_STEPS];
    for (int k = 0; k < steps; k++)
        signals[k] = set->step_columns + k * n;
    for (int k = 0; k < number; k++) {
        set->step[begin + k] = (Step){.place = event->sample - 0.5, .order = order[k]};
        fill_step_column(set->step + begin + k, n, block, signals[begin + k]);
    }
    fold(m, signals, steps, set->folded);
    for (int c = 0; c < 2; c++)
        estimate_sizes(m, event->screens->signal + c, set, begin, event->order);
    return data;
}

/* Compute the weights of the samples in the derivatives at the instant, by the models of screens
   with the columns of a set. */
static void
find_sample_weights(const Models *m, const Stencils *by, const Set *set, Lanes *lanes,
                    Screens *screens)
{
    long long n = m->count, orders = by->orders;
    double *weights = screens->sample_weights;
    memset(weights, 0, 2 * orders * n * sizeof(double));
    screens->has_sample_weights = 1;
    for (long long k = 0; k < 2 * orders; k++, weights += n) {
        const Screen *screen = screens->signal + k / orders;
        /* From a signal of zeros, so these are minus the weights. */
        subtract_model(m, screen->model, by->modes + k % orders * m->rows, weights, lanes, weights);
        for (long long x = 0; x < screen->columns; x++) {
            double change;
            if (x < set->cells)
                change = weights[set->cell[x]];
            else {
                const Step *step = set->step + x - set->cells;
                change = dot(weights, set->step_columns + (x - set->cells) * n, n);
                if (k % orders <= step->order)
                    change += step_value(step->order - k % orders, by->at - step->place);
            }
            change *= screen->factor[x];
            for (long long t = 0; t < n; t++)
                weights[t] -= change * screen->reduced_columns[x * n + t];
        }
    }
}

/* Add to a set the covariance of derivatives from the place of its last event: the weighted mean,
   over the places k, of d d'. Here d is the difference of the derivatives with the event at k from
   those with it at the best place. Weights are powers of the evidence. */
static void
add_place_covariance(const Models *m, const Stencils *by, const Set *from, const Candidate *event,
                     Lanes *lanes, double *scratch, Set *set)
{
    long long n = m->count, orders = by->orders, places = n - 2 * EDGE_SAMPLES + 1, best = 0;
    Screens *screens = event->screens;
    double *weight = scratch, *sums = scratch + n, total = 0.0;
    const double *gain = screens->gain + event->order * n + EDGE_SAMPLES;
    int is_near = 0;
    for (long long k = 0; k < places; k++)
        best = gain[k] > gain[best] ? k : best;
    for (long long k = 0; k < places; k++) {
        double loss = PLACE_EVIDENCE_POWER * (gain[best] - gain[k]);
        weight[k] = loss > MAX_LOG_CHANCE ? 0.0 : exp(-loss);
        is_near |= weight[k] > 0.0 && fabs(by->at - (k + EDGE_SAMPLES - 0.5)) < NEAR_SAMPLES;
        total += weight[k];
    }
    if (!is_near)
        return;
    if (!screens->has_sample_weights)
        find_sample_weights(m, by, from, lanes, screens);
    for (int c = 0; c < 2; c++) {
        const Screen *screen = screens->signal + c;
        for (long long o = 0; o < orders; o++)
            sum_products_with_steps(screens->sample_weights + (c * orders + o) * n, n,
                                    sums + o * STEP_ORDERS * n);
        for (int j = 0; j <= c; j++) {
            double with_best[MAX_ORDERS] = {0.0};
            /* The best place comes first, as the origin of the differences. */
            for (long long i = -1; i < places; i++) {
                long long k = i < 0 ? best : i, at = event->order * n + k + EDGE_SAMPLES;
                double off[MAX_ORDERS], ratio, size, since = by->at - (k + EDGE_SAMPLES - 0.5);
                if (weight[k] == 0.0)
                    continue;
                explained_squares(screen, at, &ratio);
                size = screen->step_products[j * STEP_ORDERS * n + at] / screen->step_squares[at] *
                    ratio / (1 + ratio);
                for (long long o = 0; o < orders; o++) {
                    double here = o > event->order ? 0.0 : step_value(event->order - o, since);
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

/* Lay out the arrays of screens, each for so many columns; returns the end of their memory. */
static char *
lay_out_screens(long long n, long long orders, long long columns, char *data, Screens *screens)
{
    for (int k = 0; k < 2; k++) {
        TAKE(screens[k].gain, STEP_ORDERS * n), TAKE(screens[k].sample_weights, 2 * orders * n);
        for (int c = 0; c < 2; c++) {
            Screen *screen = screens[k].signal + c;
            screen->c = c;
            TAKE(screen->residual, 2 * n), TAKE(screen->step_products, 2 * STEP_ORDERS * n);
            TAKE(screen->squared_products, STEP_ORDERS * n);
            TAKE(screen->step_squares, STEP_ORDERS * n);
            TAKE(screen->reduced_columns, columns * n), TAKE(screen->factor, columns);
        }
    }
    return data;
}

/* Find the best event of each order in a window without events, by the most probable models and by
   the most probable slow ones. */
static void
screen_window(const Models *m, const Samples *s, const Work *w, const Set *set, double *scratch,
              Screens *screens, Candidate *best)
{
    for (int slow = 0; slow < 2; slow++, screens++) {
        double value = 0.0;
        long long model[2];
        for (int c = 0; c < 2; c++) {
            model[c] = most_probable_model(m, set, c, slow);
            value += ((const double *)(set->evidence + c * m->groups))[model[c]];
        }
        if (slow && model[0] == screens[-1].signal[0].model &&
            model[1] == screens[-1].signal[1].model)
            break;
        for (int c = 0; c < 2; c++) {
            begin_screen(m, s, w, model[c], screens->signal + c);
            screen_steps(m, s, w, set, scratch, screens->signal + c);
        }
        screens->has_sample_weights = 0;
        find_candidates(m, w, value, screens, best);
    }
}

/* Search a window for up to two events, and evaluate the models with them. The first of `sets` has
   no events, and is evaluated already. `number` is the number of sets. */
static int
search_events(const Models *m, const Stencils *by, const Samples *s, const Work *w, long long block,
              Set *sets, int *number)
{
    long long most = sets->cells + MAX_STEPS, n = m->count, orders = by->orders;
    size_t of_set = size_of_set(m, orders, most, MAX_STEPS, 2);
    size_t of_screens = 2 * ((2 + 4 * STEP_ORDERS + most) * n + most) + STEP_ORDERS * n +
        2 * orders * n;
    size_t of_scratch = (1 + STEP_ORDERS * MAX_ORDERS) * n;
    char *data = buffer(OF_SETS, (of_scratch + 2 * of_screens) * sizeof(double) +
                                     (MAX_SETS - 1) * of_set);
    if (!data)
        return NO_MEMORY;
    Screens screens[2];
    double *scratch;
    TAKE(scratch, (1 + STEP_ORDERS * MAX_ORDERS) * n);
    data = lay_out_screens(n, orders, most, data, screens);
    Candidate events[STEP_ORDERS], next[STEP_ORDERS];
    for (int k = 0; k < STEP_ORDERS; k++)
        events[k].value = next[k].value = -INFINITY;
    screen_window(m, s, w, sets, scratch, screens, events);
    const Candidate *first = best_candidate(events);
    if (!(first->gain >= MIN_GAIN))
        return DONE;
    Set *one = NULL;
    for (int k = 0; k < STEP_ORDERS; k++) {
        if (!(events[k].gain >= MIN_GAIN) || events[k].value < first->value - MAX_EVIDENCE_BEHIND)
            continue;
        Set *set = sets + ++*number - 1;
        data = add_event(m, sets, events + k, orders, block, data, set);
        add_place_covariance(m, by, sets, events + k, w->column_products, scratch, set);
        if (events + k == first)
            one = set;
        else
            evaluate_models(m, s, w, set);
    }
    /* The second event is screened before any evaluation of the first, which may be unnecessary. */
    for (int c = 0; c < 2; c++)
        screen_steps(m, s, w, one, scratch, first->screens->signal + c);
    first->screens->has_sample_weights = 0;
    find_candidates(m, w, 0.0, first->screens, next);
    const Candidate *second = best_candidate(next);
    if (second->gain >= MIN_GAIN) {
        Set *two = sets + (*number)++;
        add_event(m, one, second, orders, block, data, two);
        add_place_covariance(m, by, one, second, w->column_products, scratch, two);
        evaluate_models(m, s, w, two);
    }
    if (second->gain < CERTAIN_GAIN)
        evaluate_models(m, s, w, one);
    else
        *one = sets[--*number];
    return DONE;
}
