#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "window_events.h"
#include "evidence.h"
#include "memory.h"
#include "numbers.h"

/* Samples between two events: nearer ones are one. */
#define APART 2
/* Log evidence that a step adds at least, if it is tried. Less than MIN_GAIN: events that windows
   of several lengths show need less in each. */
#define LEAST_GAIN 4.0
/* Samples by which the search of an event again may move it. */
#define MOVED 6
/* Screens of an event. With one, 5% fewer events are found. */
#define ROUNDS 2
/* The order of a gradual start. */
#define GRADUAL STEP_ORDERS
/* Poses in a row that are off without an event. */
#define LONGEST_OUTLIER 3
/* Steps of higher derivatives that come with that of an event, besides its shift in time: motion
   differs before and after. */
#define FOLLOWING (EVENT_COLUMNS - 2)
/* Samples beyond the radius where events are listed: a window beside may place them here. */
#define BEYOND 2
/* Sets that are in memory at once: the other events, one by one, and two of an event. */
#define KEPT_SETS (MOST_EVENTS + 2)

/* An event of a window: the likeliest place and order, and what it is with each order. */
typedef struct {
    Candidate candidate;
    double odds;                          /* of the likeliest */
    EventEstimate of_order[EVENT_ORDERS]; /* at the likeliest place of each */
    long long sample[STEP_ORDERS];        /* these places */
    int is_own[STEP_ORDERS];              /* whether the order is right: see `estimate_event` */
    int is_known;                         /* whether no other event changed since */
} Event;

/* A window whose events are searched. */
typedef struct {
    const Models *m;
    const Samples *s;
    const Work *w;
    const Set *none;
    long long block;
    double at, radius; /* samples after the first: the instant; and where events are listed */
    Screens screens;
    double *scratch; /* (count) */
    char *memory;    /* of KEPT_SETS sets */
    size_t of_set;   /* bytes of each */
    Set others, set[2]; /* those without the event that is searched; that with the likeliest so far,
                           and with another place or order */
    double without[2];  /* log evidence of the others */
    int best;           /* the number of the likeliest set */
    int events;
    Event event[MOST_EVENTS];
} Search;

/* Evaluate the models of a set, and find their probabilities. Writes the log evidence of all of
   them, `evidence` (2). */
static void
evaluate_set(const Search *search, Set *set, double *evidence)
{
    evaluate_models(search->m, search->s, search->w, set);
    for (int c = 0; c < 2; c++)
        evidence[c] = find_probabilities(search->m, c, set, 1);
}

/* Return the log odds of the last event of a set: of its log evidence `with` (2) over the one
   `without` (2). Angle and position have one place, but either may be without the step. */
static double
log_odds(const Search *search, const double *with, const double *without)
{
    double prior = log_event_prior(search->s->count), odds = prior;
    for (int c = 0; c < 2; c++) {
        double gain = with[c] - without[c] - prior;
        odds += gain > 0.0 ? gain + log1p(exp(-gain)) : log1p(exp(gain));
    }
    return odds;
}

/* Screen the window beside the events of `base`, by the models of `by`. Returns the best gain. */
static double
screen_beside(Search *search, const Set *base, const Set *by)
{
    return screen_window(search->m, search->s, search->w, base, by, search->scratch,
                         &search->screens).gain;
}

/* Make a set with an event beside those of `base`, which is screened, in the memory of the set with
   this `number`. A jump is alone: with a step of the velocity it would explain an impact. */
static void
make_set(const Search *search, const Set *base, const Candidate *event, int number, Set *set)
{
    add_event(search->m, base, &search->screens, event, event->order ? FOLLOWING : 0, 1,
              search->block, search->memory + number * search->of_set, set);
}

/* Make the set of the `others`, all events but the one with this number, and screen the window
   beside them. */
static void
leave_out(Search *search, int number)
{
    Set set[MOST_EVENTS];
    int added = 0;
    set[0] = *search->none;
    for (int k = 0; k < search->events; k++)
        if (k != number) {
            screen_beside(search, set + added, search->none);
            make_set(search, set + added, &search->event[k].candidate, added, set + added + 1);
            added++;
        }
    search->others = set[added];
    evaluate_set(search, &search->others, search->without);
    screen_beside(search, &search->others, &search->others);
}

/* Add the mean size of a column and its square, by the probabilities of a group's models and for
   signal `c`, to `sum` (2). `size` (columns) are the sizes of `find_sizes`. */
static void
add_size(const Search *search, const Set *set, long long group, int c, long long column,
         const Lanes *size, double *sum)
{
    long long number = set->columns, part = set->parts > 1 && c > 0;
    const Lanes *factor = set->factors + (group * set->parts + part) * number * (number + 1) / 2;
    double root = set->root[part * number + column];
    Lanes probability = set->probability[(c > 0) * search->m->groups + group];
    /* The variance is that of the noise times an element of the inverse, by forward
       substitution. */
    Lanes *unit = search->w->over_pivots + number, variance = all_lanes(0.0);
    unit[column] = all_lanes(1.0);
    for (long long x = column; x < number; x++) {
        const Lanes *row = factor + x * (x + 1) / 2;
        if (x > column)
            unit[x] = all_lanes(0.0);
        for (long long k = column; k < x; k++)
            unit[x] = multiply_subtract(unit[x], row[k], unit[k]);
        variance = multiply_add(variance, product(unit[x], unit[x]), row[x]);
    }
    Lanes noise = set->variance[(c > 0) * search->m->groups + group];
    Lanes square = multiply_add(product(variance, noise), size[column], size[column]);
    sum[0] += root * sum_of(product(probability, size[column]));
    sum[1] += root * root * sum_of(product(probability, square));
}

/* Estimate the last event of an evaluated set, whose columns begin at `first`: its steps and place,
   without other places. Returns whether its order is right: its step is more than what that of the
   next derivative makes of it in a sample. */
static int
estimate_event(const Search *search, const Set *set, long long first, EventEstimate *out)
{
    const Step *step = set->step + first - set->low_samples;
    long long columns = set->columns - first, shift_column = step->order ? 1 : columns;
    double along = 0.0, square = 0.0, own = 0.0, next = 0.0;
    for (int c = 0; c < 3; c++) {
        double sum[EVENT_COLUMNS][2] = {{0.0}};
        for (long long g = 0; g < search->m->groups; g++)
            if (sum_of(set->probability[(c > 0) * search->m->groups + g]) > 0.0) {
                find_sizes(set, g, c, search->w->over_pivots);
                for (int k = 0; k < columns; k++)
                    add_size(search, set, g, c, first + k, search->w->over_pivots, sum[k]);
            }
        out->step[c] = sum[0][0];
        out->step_sigma[c] = sqrt(larger(sum[0][1] - sum[0][0] * sum[0][0], 0.0));
        own += sum[0][0] * sum[0][0];
        /* Less the variance: it may be noise. */
        if (columns > 1)
            next += 2 * sum[2][0] * sum[2][0] - sum[2][1];
        /* The step of the derivative below is the size times minus the shift in time. */
        const double *shift = sum[shift_column < columns ? shift_column : 0];
        double variance = shift_column < columns ? shift[1] - shift[0] * shift[0] : 0.0;
        if (variance > 0.0) {
            along -= out->step[c] * shift[0] / variance;
            square += out->step[c] * out->step[c] / variance;
        }
    }
    /* More is no shift: then another place is likelier. */
    double moved = square > 0.0 ? larger(-0.5, smaller(0.5, along / square)) : 0.0;
    out->place = step->place + moved - search->at;
    out->place_sigma = square > 0.0 ? 1 / sqrt(square) : 0.5;
    return own >= next;
}

/* Evaluate an event beside the others, in the set that is not the likeliest. Returns its log
   odds, -infinity at an edge. */
static double
evaluate_event(Search *search, const Candidate *event)
{
    double with[2];
    int spare = !search->best;
    if (event->sample < EDGE_SAMPLES || event->sample > search->s->count - EDGE_SAMPLES)
        return -INFINITY;
    make_set(search, &search->others, event, MOST_EVENTS + spare, search->set + spare);
    evaluate_set(search, search->set + spare, with);
    return log_odds(search, with, search->without);
}

/* Try an event at a place, with an order. Keeps what is better than before. */
static void
try_place(Search *search, int order, long long sample, Event *event)
{
    Candidate candidate = {.order = order, .sample = sample};
    double odds = evaluate_event(search, &candidate);
    if (odds > event->of_order[order].odds) {
        event->is_own[order] = estimate_event(search, search->set + !search->best,
                                              search->others.columns, event->of_order + order);
        event->of_order[order].odds = odds, event->sample[order] = sample;
    }
    if (odds > event->odds) {
        event->odds = odds, event->candidate = candidate;
        search->best = !search->best;
    }
}

/* Return the place of the best step of an order from sample `first` to `last`; -1 if there is
   none. */
static long long
best_of_order(const Search *search, int order, long long first, long long last)
{
    long long n = search->s->count, edge = EDGE_SAMPLES + (order > 1 ? MORE_EDGE_SAMPLES : 0);
    long long best = -1;
    const double *gain = search->screens.gain + order * n;
    for (long long k = larger(first, edge); k <= smaller(last, n - edge); k++)
        if (best < 0 || gain[k] > gain[best])
            best = k;
    return best;
}

/* Find an event from sample `first` to `last` beside the others, which are screened: its likeliest
   place with each order. Those of the screen are tried, and the likeliest models then screen again,
   until they have no other place. The place `old`, if it is not negative, is tried first. */
static void
find_beside(Search *search, long long first, long long last, long long old, Event *event)
{
    long long places[STEP_ORDERS][ROUNDS];
    search->best = 0;
    *event = (Event){.odds = -INFINITY, .is_known = 1};
    for (int order = 0; order < EVENT_ORDERS; order++)
        event->of_order[order].odds = -INFINITY;
    for (int order = 1; order < (old < 0 ? 0 : STEP_ORDERS); order++)
        try_place(search, order, old, event);
    for (int round = 0; round < ROUNDS; round++) {
        int is_new = 0;
        if (event->odds > -INFINITY)
            screen_beside(search, &search->others, search->set + search->best);
        for (int order = 1; order < STEP_ORDERS; order++) {
            long long sample = best_of_order(search, order, first, last);
            int is_tried = sample < 0 || sample == old;
            for (int k = 0; k < round; k++)
                is_tried |= places[order][k] == sample;
            places[order][round] = sample;
            if (!is_tried)
                try_place(search, order, sample, event);
            is_new |= !is_tried;
        }
        if (!is_new)
            break;
    }
}

/* Compare an event that is found beside the others with samples in a row that are off, near its
   jump: from one sample on, as long as it gets better. */
static void
compare_outlier(Search *search, Event *event)
{
    static const int moves[][2] = {{-1, 0}, {1, 0}, {0, 1}, {-1, 1}};
    Candidate best = {.sample = event->sample[0], .length = 1};
    double odds = evaluate_event(search, &best);
    for (int is_better = 1; is_better;) {
        Candidate from = best;
        is_better = 0;
        for (int k = 0; k < 4 && !is_better; k++) {
            Candidate tried = {.sample = from.sample + moves[k][0],
                               .length = from.length + moves[k][1]};
            if (tried.length > LONGEST_OUTLIER)
                break;
            double other = evaluate_event(search, &tried);
            if (other > odds)
                odds = other, best = tried, is_better = 1;
        }
    }
    event->of_order[0].odds = larger(event->of_order[0].odds, odds);
}

/* Compare an event that is found beside the others with a gradual start, near and before the best
   place of a step of the acceleration: from one sample to the one before, until it gets worse. */
static void
compare_gradual_start(Search *search, Event *event)
{
    Candidate start = {.order = GRADUAL, .sample = event->sample[GRADUAL - 1]};
    double odds;
    while ((odds = evaluate_event(search, &start)) > event->of_order[GRADUAL].odds) {
        event->of_order[GRADUAL].odds = odds;
        start.sample--;
    }
}

/* Whether an event is listed. */
static int
is_listed(const Search *search, const Event *event)
{
    return fabs(event->candidate.sample - 0.5 - search->at) <= search->radius + BEYOND;
}

/* Compare an event that is listed, and found beside the others, with what is none. An order that is
   not right leaves its log odds to the next one. */
static void
compare_with_none(Search *search, Event *event)
{
    screen_beside(search, &search->others, search->set + search->best);
    long long near = event->candidate.sample;
    try_place(search, 0, best_of_order(search, 0, near - MOVED, near + MOVED), event);
    if (event->of_order[0].odds > 0.0)
        compare_outlier(search, event);
    compare_gradual_start(search, event);
    for (int order = 0; order < STEP_ORDERS; order++)
        if (!event->is_own[order]) {
            EventEstimate *of_order = event->of_order + order;
            of_order[1].odds = larger(of_order[0].odds, of_order[1].odds);
            of_order[0].odds = -INFINITY;
        }
}

/* Whether the event with this number is at the place of one before it. */
static int
is_at_other(const Search *search, int number)
{
    const Event *event = search->event;
    int found = 0;
    for (int k = 0; k < number; k++)
        found |= llabs(event[k].candidate.sample - event[number].candidate.sample) < APART;
    return found;
}

/* Find events one by one, until none is likely beside those before it. The last one is compared
   with what is none. */
static void
find_one_by_one(Search *search)
{
    Set set[MOST_EVENTS + 1];
    double evidence[MOST_EVENTS + 1][2];
    int number = 0;
    set[0] = *search->none;
    evaluate_set(search, set, evidence[0]);
    for (; number < MOST_EVENTS; number++) {
        Event *event = search->event + number;
        if (!(screen_beside(search, set + number, set + number) >= LEAST_GAIN))
            break;
        search->others = set[number];
        memcpy(search->without, evidence[number], sizeof search->without);
        find_beside(search, 0, search->s->count, -1, event);
        if (event->odds <= 0.0 || is_at_other(search, number))
            break;
        if (number)
            event[-1].is_known = 0;
        make_set(search, set + number, &event->candidate, number, set + number + 1);
        evaluate_set(search, set + number + 1, evidence[number + 1]);
    }
    search->events = number;
    if (number && is_listed(search, search->event + number - 1)) {
        search->others = set[number - 1], search->set[0] = set[number], search->best = 0;
        memcpy(search->without, evidence[number - 1], sizeof search->without);
        compare_with_none(search, search->event + number - 1);
    }
}

/* Find events again that are not known beside all others, from the last one to the first. What is
   not likely any more is removed. */
static void
find_again(Search *search)
{
    for (int k = search->events - 1; k >= 0; k--) {
        Event *event = search->event + k;
        Candidate old = event->candidate;
        if (event->is_known)
            continue;
        leave_out(search, k);
        find_beside(search, old.sample - MOVED, old.sample + MOVED, old.sample, event);
        if (is_listed(search, event))
            compare_with_none(search, event);
        int is_gone = event->odds <= 0.0;
        if (is_gone || event->candidate.sample != old.sample || event->candidate.order != old.order)
            for (int j = 0; j < search->events; j++)
                search->event[j].is_known = j == k;
        if (is_gone) {
            search->events--;
            for (int j = k; j < search->events; j++)
                search->event[j] = search->event[j + 1];
        }
    }
}

PRIVATE int
find_window_events(Call *call, const Models *m, const Samples *s, const Work *w, long long block,
                   const Set *none, double at, double radius, Estimate *out)
{
    long long n = m->count, most = none->low_samples + STEP_COLUMNS;
    Search search = {
        .m = m, .s = s, .w = w, .none = none, .block = block, .at = at, .radius = radius};
    search.of_set = size_of_set(m, 1, most, STEP_COLUMNS, 2);
    char *data = kinpole_buffer(
        call, OF_SETS,
        n * sizeof(double) + size_of_screens(n, 1, most) + KEPT_SETS * search.of_set);
    if (!data)
        return NO_MEMORY;
    TAKE(search.scratch, n);
    search.memory = lay_out_screens(n, 1, most, data, &search.screens);
    find_one_by_one(&search);
    int listed = 0;
    for (int k = 0; k < search.events; k++)
        listed += is_listed(&search, search.event + k);
    for (int pass = 0; pass < (listed ? 2 : 0); pass++)
        find_again(&search);
    for (int k = 0; k < search.events; k++)
        if (is_listed(&search, search.event + k))
            memcpy(out->event[out->events++], search.event[k].of_order,
                   sizeof search.event[k].of_order);
    return DONE;
}
