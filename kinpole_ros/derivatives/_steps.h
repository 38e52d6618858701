/*
 * Events: instants at which the position, the velocity or the acceleration steps, as at an impact.
 *
 * The search has two stages. Screening: with two or three of the models, the evidence that a step
 * of each order at each place would add follows from cumulative sums of the residuals (`Screen`,
 * `find_candidates`). Evaluation: the best candidates become columns of the regression, and all
 * models are evaluated with them (`add_event`, `find_evidence`). The second event is screened with
 * the first one in place, before any evaluation.
 *
 * The search alone: `prepare`, `find_squares` and `find_evidence` of a window, then
 * `search_events` (_derive.c). It returns sets of events. `step[k].place` is in samples after the
 * first, `step[k].order` is the order of the derivative that steps, and `root` is the size. The
 * evidence of a set less that of the first set, which has no events, says how sure the events are.
 */

/* Orders of derivatives that may step: position, velocity and acceleration. */
#define ORDERS 3
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

/* One model with the columns of a set, on the angle (c = 0) or the position (c = 1). `residual`
   (c + 1, count) are its residuals, and `sums` their products with a step of each order at each
   place (ORDERS, count), with sum of squares `explained`. `left` is what the model leaves of the
   squares of these steps. `removed` (columns, count) are the columns as the model and the columns
   before leave them, each subtracted with `factor`. */
typedef struct {
    int c;
    long long model, columns;
    double squares, *residual, *sums, *explained, *left, *removed, *factor;
} Screen;

/* The screens of angle and position. `gain` (ORDERS, count) is the log evidence that a step of each
   order at each place adds by both, without the cost of its size. `reach` (2, orders, count) are
   the weights of the samples in the derivatives at the instant, if `has_sample_weights`. */
typedef struct {
    Screen of[2];
    double *gain, *reach;
    int has_sample_weights;
} Screens;

/* An event half a sample before `sample`: its log evidence, and the part that the event adds. */
typedef struct {
    double value, gain;
    long long sample;
    Screens *screens;
} Candidate;

/* Return the number of the most probable model of a set, or of its slow models. */
static long long
find_likeliest(const Models *m, const Set *set, int c, int slow)
{
    const double *evidence = (const double *)(set->evidence + c * m->groups);
    long long process = m->chunks * LANES, best = 0;
    for (long long k = 0; k < m->groups * LANES; k++) {
        /* Processes of a spectrum are in the order of their lengths. */
        int fast = k >= SLOW_LENGTHS * process && m->kind[k - SLOW_LENGTHS * process] == m->kind[k];
        int allowed = slow ? m->kind[k] < m->kinds - 1 && !fast : m->kind[k] != m->kinds - 1;
        if (allowed && evidence[k] > evidence[best])
            best = k;
    }
    return best;
}

/* Subtract from a signal (count) with these modes what a model explains. */
static void
subtract_model(const Models *m, long long model, const double *modes, const double *signal,
               Lanes *sums, double *left)
{
    long long group = model / LANES, lane = model % LANES, n = m->count;
    const double *share = (const double *)(m->share + group % m->chunks * m->rows) + lane;
    const long long *first = m->first + group / m->chunks;
    memcpy(left, signal, n * sizeof(double));
    for (int parity = 0; parity < 2; parity++, first += m->processes + 1) {
        memset(sums, 0, m->half * sizeof(Lanes));
        for (long long r = first[0] / LANES * LANES; r < first[1]; r += LANES) {
            Lanes factor = all_lanes(0.0);
            for (long long k = r > first[0] ? r : first[0]; k < r + LANES && k < first[1]; k++)
                ((double *)&factor)[k - r] = share[k * LANES] * modes[k];
            for (long long t = 0; t < m->half; t++)
                sums[t] = plus(sums[t], factor, m->panels[r / LANES * m->half + t]);
        }
        for (long long t = 0; t < m->half; t++) {
            double sum = sum_of(sums[t]);
            left[t] -= t == n - 1 - t ? 2 * sum : sum;
            if (t != n - 1 - t)
                left[n - 1 - t] -= parity ? -sum : sum;
        }
    }
}

/* Subtract model and earlier columns from a column (count) with these modes, into the next row of
   `removed`. Returns the product of the column with it, and in `along` the RMS of its products with
   the residuals. */
static double
measure_column(const Models *m, Screen *screen, const double *column, const double *modes,
               Lanes *sums, double *along)
{
    long long n = m->count;
    double *own = screen->removed + screen->columns * n, square = 0.0;
    subtract_model(m, screen->model, modes, column, sums, own);
    for (long long k = 0; k < screen->columns; k++) {
        const double *other = screen->removed + k * n;
        double by = screen->factor[k] * dot(other, column, n);
        for (long long t = 0; t < n; t++)
            own[t] -= by * other[t];
    }
    for (int j = 0; j <= screen->c; j++) {
        double product = dot(column, screen->residual + j * n, n);
        square += product * product / (screen->c + 1);
    }
    *along = sqrt(square);
    double left = dot(column, own, n);
    return left > MIN_STEP_LEFT * MIN_STEP_LEFT * dot(column, column, n) ? left : 0.0;
}

/* Add the column that was measured last to those of the screen. */
static void
remove_column(const Models *m, Screen *screen, const Samples *s, double left, double weight,
                double root)
{
    long long n = m->count;
    const double *own = screen->removed + screen->columns * n;
    double factor = root > 0.0 ? root * root / (weight + root * root * left) : 0.0;
    for (int j = 0; j <= screen->c; j++) {
        double by = factor * dot(own, s->x[screen->c + j], n);
        for (long long t = 0; t < n; t++)
            screen->residual[j * n + t] -= by * own[t];
    }
    screen->factor[screen->columns++] = factor;
}

/* Compute the products (ORDERS, count) of a signal with steps half a sample before each sample. */
static void
sum_products_with_steps(const double *signal, long long count, double *sums)
{
    /* Of the signal times binomial coefficients of the time since. */
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
screen_steps(const Models *m, const Samples *s, const Work *w, const Set *set, Screen *screen,
             double *spare)
{
    long long n = m->count, part = set->parts > 1 && screen->c > 0;
    Lanes *sums = w->off;
    const double *whole = m->unexplained + screen->model * ORDERS * n;
    for (long long x = screen->columns; x < set->columns; x++) {
        const double *column = spare;
        double along, weight = set->weight[part * set->columns + x];
        if (x < set->cells)
            memset(spare, 0, n * sizeof(double)), spare[set->at[x]] = 1.0;
        else
            column = set->values + (x - set->cells) * n;
        double left = measure_column(m, screen, column, set->vectors + x * m->rows, sums, &along);
        remove_column(m, screen, s, left, weight, set->root[part * set->columns + x]);
        sum_products_with_steps(screen->removed + x * n, n, screen->explained);
        for (long long k = 0; k < ORDERS * n; k++)
            screen->left[k] -= screen->factor[x] * screen->explained[k] * screen->explained[k];
    }
    memset(screen->explained, 0, ORDERS * n * sizeof(double));
    screen->squares = 0.0;
    for (int j = 0; j <= screen->c; j++) {
        screen->squares += dot(screen->residual + j * n, s->x[screen->c + j], n);
        double *sums = screen->sums + j * ORDERS * n;
        sum_products_with_steps(screen->residual + j * n, n, sums);
        for (long long k = 0; k < ORDERS * n; k++)
            screen->explained[k] += sums[k] * sums[k];
    }
    screen->squares = larger(screen->squares, 0.0);
    for (long long k = 0; k < ORDERS * n; k++)
        screen->left[k] = screen->left[k] > MIN_STEP_LEFT * whole[k] ? screen->left[k] : INFINITY;
}

/* Begin to screen with a model. */
static void
begin_screen(const Models *m, const Samples *s, const Work *w, long long model, Screen *screen)
{
    long long n = m->count;
    screen->model = model, screen->columns = 0;
    for (int j = 0; j <= screen->c; j++)
        subtract_model(m, model, w->modes + (screen->c + j) * m->rows, s->x[screen->c + j], w->off,
              screen->residual + j * n);
    memcpy(screen->left, m->unexplained + model * ORDERS * n, ORDERS * n * sizeof(double));
}

/* Return by how much a step of the estimated size reduces the sum of squares. */
static inline double
explained_of(const Screen *screen, long long k, double *square)
{
    *square = screen->explained[k] / screen->left[k] / (screen->c + 1);
    return (screen->c + 1) * *square * *square / (1 + *square);
}

/* Return the log evidence that a step of the estimated size adds. */
static double
evidence_gain(const Screen *screen, const Work *w, long long k)
{
    double square, explained = explained_of(screen, k, &square);
    double before = screen->squares + w->known;
    double number = w->known + w->seen[screen->c] * (screen->c + 1);
    double after = larger(before - explained, w->known);
    return larger(number / 2 * log(before / after) - (screen->c + 1) * log(1 + square) / 2, 0.0);
}

/* Find the best place of a step of each order. The gain at a place uses a rational approximation of
   the logarithm, since there are many places. */
static void
find_candidates(const Models *m, const Work *w, double value, Screens *screens, Candidate *best)
{
    long long n = m->count;
    memset(screens->gain, 0, ORDERS * n * sizeof(double));
    for (int c = 0; c < 2; c++) {
        const Screen *screen = screens->of + c;
        double per = 1 / (c + 1.0), all = 1 / (screen->squares + w->known);
        double number = (w->known + w->seen[c] * (c + 1)) / 2;
        for (long long k = 0; k < ORDERS * n; k++) {
            double square = screen->explained[k] / screen->left[k] * per;
            double part = smaller((c + 1) * all * square * square / (1 + square), 1.0);
            screens->gain[k] += number * part * (6 - part) / (6 - 4 * part);
        }
    }
    for (int order = 0; order < ORDERS; order++) {
        long long at = order * n + EDGE_SAMPLES;
        for (long long k = at; k <= (order + 1) * n - EDGE_SAMPLES; k++)
            if (screens->gain[k] > screens->gain[at])
                at = k;
        double gain = evidence_gain(screens->of, w, at) + evidence_gain(screens->of + 1, w, at);
        Candidate one = {value + gain, gain, at - order * n, screens};
        if (one.value > best[order].value)
            best[order] = one;
    }
}

/* Return the order of the best candidate. */
static int
best_candidate(const Candidate *candidates)
{
    int best = 0;
    for (int k = 1; k < ORDERS; k++)
        best = candidates[k].value > candidates[best].value ? k : best;
    return best;
}

/* Set the prior standard deviations of the columns of a new event, in turn, to the sizes that the
   model of a screen estimates. */
static void
estimate_sizes(const Models *m, const Screen *screen, Set *set, int order, double *spare)
{
    long long n = m->count, begin = set->from->steps, number = set->steps - begin, c = screen->c;
    long long group = screen->model / LANES, lane = screen->model % LANES;
    const double *columns = set->values + begin * n;
    const double *modes = set->vectors + (set->cells + begin) * m->rows;
    double *weight = set->weight + c * set->columns + set->cells + begin;
    double *root = set->root + c * set->columns + set->cells + begin, place = MIN_PLACE_SIGMA;
    double between[EVENT_COLUMNS][EVENT_COLUMNS], square[EVENT_COLUMNS], along[2][EVENT_COLUMNS];
    const double *share = (const double *)(m->share) + lane;
    find_modes_of_steps(m, group, set);
    for (int k = 0; k < number; k++) {
        for (int l = 0; l <= k; l++)
            between[k][l] = dot(columns + k * n, columns + l * n, n);
        square[k] = between[k][k];
        for (int j = 0; j <= c; j++)
            along[j][k] = dot(columns + k * n, screen->residual + j * n, n);
    }
    for (int parity = 0; parity < 2; parity++) {
        const long long *first = m->first + parity * (m->processes + 1) + group;
        for (long long r = first[0]; r < first[1]; r++)
            for (int k = 0; k < number; k++)
                for (int l = 0; l <= k; l++)
                    between[k][l] -= share[r * LANES] * modes[k * m->rows + r] *
                        modes[l * m->rows + r];
    }
    for (long long x = 0; x < screen->columns; x++) {
        for (int k = 0; k < number; k++)
            spare[k] = dot(columns + k * n, screen->removed + x * n, n);
        for (int k = 0; k < number; k++)
            for (int l = 0; l <= k; l++)
                between[k][l] -= screen->factor[x] * spare[k] * spare[l];
    }
    for (int k = 0; k < number; k++) {
        int each = set->step[begin + k].order;
        double left = between[k][k], size = 0.0;
        if (!(left > MIN_STEP_LEFT * MIN_STEP_LEFT * square[k]))
            left = 0.0;
        for (int j = 0; j <= c; j++)
            size += along[j][k] * along[j][k] / (c + 1);
        /* A smaller one than its standard deviation is not estimated: it might be rounding. */
        root[k] = left > 0.0 ? sqrt(larger(size, left)) / left : 0.0;
        if (each == order - 1) {
            double known = root[0] * sqrt((c + 1) * left);
            if (known > 0.0)
                place = smaller(larger(1 / known, MIN_PLACE_SIGMA), MAX_PLACE_SIGMA);
            root[k] = root[0] * place;
        }
        weight[k] = 1.0;
        double factor = root[k] * root[k] / (1.0 + root[k] * root[k] * left);
        for (int l = k + 1; l < number; l++) {
            for (int i = k + 1; i <= l; i++)
                between[l][i] -= factor * between[l][k] * between[i][k];
            for (int j = 0; j <= c; j++)
                along[j][l] -= factor * between[l][k] * along[j][k];
        }
    }
}

/* Copy a set, and add the columns of an event. The new set is laid out at `data`; returns the end
   of its memory. */
static char *
add_event(const Models *m, const Set *from, const Candidate *candidate, int order,
            long long orders, long long block, char *data,
           Set *set, double *spare)
{
    long long n = m->count, cells = from->cells, begin = from->steps, number = 1;
    /* The next derivative is the last: the other sizes are known then. */
    int each[EVENT_COLUMNS] = {order};
    if (order)
        each[number++] = order - 1;
    each[number++] = order + 1;
    long long steps = begin + number, columns = cells + steps;
    data = lay_out_set(m, orders, columns, steps, 2, data, set);
    set->from = from, set->cells = cells, set->steps = steps, set->events = from->events + 1;
    set->prior = from->prior + log(EVENT_PRIOR / (1 - EVENT_PRIOR) / (ORDERS * n)) - SIZE_COST;
    memcpy(set->at, from->at, cells * sizeof *set->at);
    memcpy(set->step, from->step, sizeof set->step);
    memcpy(set->spread, from->spread, sizeof set->spread);
    memcpy(set->values, from->values, begin * n * sizeof(double));
    memcpy(set->vectors, from->vectors, from->columns * m->rows * sizeof(double));
    for (int part = 0; part < 2; part++) {
        long long there = part < from->parts ? part * from->columns : 0;
        memcpy(set->weight + part * columns, from->weight + there, from->columns * sizeof(double));
        memcpy(set->root + part * columns, from->root + there, from->columns * sizeof(double));
    }
    double *signals[MOST_STEPS];
    for (int k = 0; k < steps; k++)
        signals[k] = set->values + k * n;
    for (int k = 0; k < number; k++) {
        set->step[begin + k] = (Step){.place = candidate->sample - 0.5, .order = each[k]};
        find_values(set->step + begin + k, n, block, signals[begin + k]);
    }
    fold(m, signals, steps, set->folded);
    for (int c = 0; c < 2; c++)
        estimate_sizes(m, candidate->screens->of + c, set, order, spare);
    return data;
}

/* Compute the weights of the samples in the derivatives at the instant, by the models of screens
   with the columns of a set. */
static void
find_sample_weights(const Models *m, const Stencils *by, const Set *set, Screens *screens,
                    Lanes *lanes)
{
    long long n = m->count, orders = by->orders;
    double *weights = screens->reach;
    memset(weights, 0, 2 * orders * n * sizeof(double));
    screens->has_sample_weights = 1;
    for (long long k = 0; k < 2 * orders; k++, weights += n) {
        const Screen *screen = screens->of + k / orders;
        /* Less what the model makes of them. */
        subtract_model(m, screen->model, by->modes + k % orders * m->rows, weights, lanes, weights);
        for (long long x = 0; x < screen->columns; x++) {
            double change;
            if (x < set->cells)
                change = weights[set->at[x]];
            else {
                const Step *step = set->step + x - set->cells;
                change = dot(weights, set->values + (x - set->cells) * n, n);
                if (k % orders <= step->order)
                    change += step_value(step->order - k % orders, by->at - step->place);
            }
            change *= screen->factor[x];
            for (long long t = 0; t < n; t++)
                weights[t] -= change * screen->removed[x * n + t];
        }
    }
}

/* Add to a set the covariance of derivatives that follows from the place of its last event: at each
   place, weighted by the evidence there, the derivatives differ from those with the best place. */
static void
add_place_covariance(const Models *m, const Stencils *by, const Set *from,
                     const Candidate *candidate, int order, Lanes *lanes, double *spare, Set *set)
{
    long long n = m->count, orders = by->orders, places = n - 2 * EDGE_SAMPLES + 1, best = 0;
    Screens *screens = candidate->screens;
    double *chance = spare, *sums = spare + n, total = 0.0;
    const double *gain = screens->gain + order * n + EDGE_SAMPLES;
    int near = 0;
    for (long long k = 0; k < places; k++)
        best = gain[k] > gain[best] ? k : best;
    for (long long k = 0; k < places; k++) {
        double less = PLACE_EVIDENCE_POWER * (gain[best] - gain[k]);
        chance[k] = less > MAX_LOG_CHANCE ? 0.0 : exp(-less);
        near |= chance[k] > 0.0 && fabs(by->at - (k + EDGE_SAMPLES - 0.5)) < NEAR_SAMPLES;
        total += chance[k];
    }
    if (!near)
        return;
    if (!screens->has_sample_weights)
        find_sample_weights(m, by, from, screens, lanes);
    for (int c = 0; c < 2; c++) {
        const Screen *screen = screens->of + c;
        for (long long o = 0; o < orders; o++)
            sum_products_with_steps(screens->reach + (c * orders + o) * n, n,
                                    sums + o * ORDERS * n);
        for (int j = 0; j <= c; j++) {
            double middle[MOST_ORDERS] = {0.0};
            for (long long i = -1; i < places; i++) {
                /* About what is found with the event at its best place. */
                long long k = i < 0 ? best : i, at = order * n + k + EDGE_SAMPLES;
                double off[MOST_ORDERS], square, size, since = by->at - (k + EDGE_SAMPLES - 0.5);
                if (chance[k] == 0.0)
                    continue;
                explained_of(screen, at, &square);
                size = screen->sums[j * ORDERS * n + at] / screen->left[at] * square / (1 + square);
                for (long long o = 0; o < orders; o++) {
                    double here = o > order ? 0.0 : step_value(order - o, since);
                    off[o] = size * (here + sums[o * ORDERS * n + at]) - middle[o];
                }
                if (i < 0)
                    memcpy(middle, off, sizeof middle);
                for (long long o = 0; o < orders; o++)
                    for (long long p = 0; p < (i < 0 ? 0 : orders); p++)
                        set->spread[c][o][p] += chance[k] / total / (c + 1) * off[o] * off[p];
            }
        }
    }
}
