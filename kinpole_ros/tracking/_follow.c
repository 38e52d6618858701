/*
 * Frame by frame from points to derivatives: the loop that live and replay share.
 *
 * Whatever is not usual ends the loop, and step.py goes on with it. Results are those of the frame
 * that falls due, computed from the window of frames up to the newest.
 */

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "../derivatives/_call.h"
#include "_frames.h"

#pragma GCC optimize("O3", "cx-limited-range")

/* Results (T, ...) of `instants` instants, of which there are `count`, as `Estimate` has them; there
   is no result of more. `derivatives` are those of `Call` for all of them. */
typedef struct {
    long long instants, count, fewest;
    long long *stamp, *due;
    double *derivatives, *size, *height, *pin_variance, *angle, *information, *noise;
    Number *pin, *shape, *reference, *position, *middle;
    unsigned char *missing;
} Results;

/* Why the loop ends, besides the codes of `Call`. */
enum { UNUSUAL = 2, SEEN_AGAIN, DEFORMED, FULL };
/* Why a body has no result, the most important last: see results.py. */
enum { KNOWN, NOT_FULL, TOO_NOISY, NOISE_UNKNOWN, NOT_SEEN };

/* Room for one call of `kinpole_derive`. */
typedef struct {
    double *angle, *heading, *turn_information, *place_information, *found;
    Number *position, *hub;
    long long frames[3];
} Room;

static Number
unit_at(double angle)
{
    return cos(angle) + I * sin(angle);
}

/* How many frames were before `at`, ns. */
static long long
number_before(const Frames *f, long long at)
{
    long long low = f->first, high = f->end;
    while (low < high) {
        long long middle = (low + high) / 2;
        if (f->time[middle] < at)
            low = middle + 1;
        else
            high = middle;
    }
    return low - f->first;
}

/* Takes the next frame as it comes, if it is usual. */
static int
take(Frames *f)
{
    long long all = f->bodies * f->markers, row = f->end, k = f->frame;
    const Number *points = f->points + k * all;
    const double *heights = f->point_heights + k * all;
    if (f->hidden_is_unusual)
        for (long long i = 0; i < all; i++)
            if (isnan(creal(points[i])))
                return UNUSUAL;
    int goes_on = row == f->first || f->interval == 0 ||
        f->new_time[k] - f->time[row - 1] <= f->gap * f->interval;
    f->end++;
    if (kinpole_fit_frame(f, points, goes_on, f->unusual)) {
        f->end--;
        return UNUSUAL;
    }
    f->stamp[row] = f->new_stamp[k], f->time[row] = f->new_time[k], f->count[row] = f->new_count[k];
    f->goes_on[row] = goes_on;
    memcpy(f->marker + row * all, points, all * sizeof *points);
    memcpy(f->heights + row * all, heights, all * sizeof *heights);
    int again = 0;
    for (long long b = 0; b < f->bodies; b++) {
        double sum = 0.0;
        long long seen = 0;
        for (long long i = b * f->markers; i < (b + 1) * f->markers; i++)
            if (!isnan(creal(points[i])))
                sum += heights[i], seen++;
        f->height[row * f->bodies + b] = seen ? sum / seen : NAN;
        f->extra_turn[row * f->bodies + b] = 0.0;
    }
    kinpole_follow_paths(f, f->wrong, f->newest);
    for (long long b = 0; b < f->bodies; b++) {
        if (isnan(f->angle[row * f->bodies + b]))
            continue;
        again |= f->seen_last[b] >= 0 && f->stamp[row] - f->seen_last[b] >= f->window;
        if (!again)
            f->seen_last[b] = f->stamp[row];
    }
    f->frame++, f->until_update--;
    return again ? SEEN_AGAIN : DONE;
}

/* Whether a body was on its pin in all frames of the window, save for single poses off it. */
static int
holds_on_pin(const Frames *f, long long oldest, long long b)
{
    if (!(isfinite(creal(f->pin[b])) && f->pin_since[b] <= f->time[oldest]))
        return 0;
    int off = 0;
    for (long long row = oldest; row < f->end; row++) {
        const double *information = f->information + 2 * row * f->bodies + b;
        if (!(information[0] > 0.0 && information[f->bodies] > 0.0))
            continue;
        long long at = row * f->bodies + b;
        double turned = f->error[b] / (information[0] * f->scale[b]);
        double placed = f->error[b] / (information[f->bodies] * f->scale[f->bodies + b]);
        double square =
            square_of(f->position[at] + unit_at(f->angle[at]) * f->pin_arm[b] - f->pin[b]);
        off += square > f->sure * f->sure * (placed + square_of(f->pin_arm[b]) * turned);
    }
    return off < 3;
}

/* Fills the room with poses of the hubs in the window from `oldest` on; whether bodies tilt. */
static int
fill_room(const Frames *f, long long oldest, Room *room)
{
    int tilts = 0;
    for (long long i = oldest * f->bodies; f->posed && i < f->end * f->bodies; i++)
        tilts |= f->extra_turn[i] != 0.0;
    for (long long row = oldest; row < f->end; row++)
        for (long long b = 0; b < f->bodies; b++) {
            long long at = row * f->bodies + b, to = at - oldest * f->bodies;
            const double *information = f->information + 2 * row * f->bodies + b;
            double turned = information[0] * f->scale[b];
            double placed = information[f->bodies] * f->scale[f->bodies + b], far = 0.0;
            Number hub = room->hub[b], position = f->position[at];
            room->heading[to] = f->angle[at];
            room->angle[to] = f->angle[at] + (tilts ? f->extra_turn[at] - f->turned[b] : 0.0);
            if (hub != 0.0) {
                position += hub * unit_at(room->angle[to]);
                /* Farther from the middle of the markers the error of the angle tells more. Without
                   its other markers a body may seem to lie far from its middle. */
                if (placed > 0.0) {
                    double share = placed / turned;
                    far = 1.0 - square_of(f->middle[b]) * share;
                    far = (far > 0.0 ? far : 0.0) + square_of(hub - f->middle[b]) * share;
                }
            }
            room->position[to] = position;
            room->turn_information[to] = turned;
            room->place_information[to] = far > 0.0 ? placed / far : placed;
        }
    return tilts;
}

/* The mean of the markers that are used in a row, in the axes of the body. */
static Number
middle_of_used(const Frames *f, long long row, long long b)
{
    Number sum = 0.0;
    double total = 0.0;
    for (long long k = 0; k < f->markers; k++)
        if (f->used[(row * f->bodies + b) * f->markers + k]) {
            double weight = f->weights[b * f->markers + k];
            sum += weight * f->shape[b * f->markers + k], total += weight;
        }
    return total > 0.0 ? sum / total : NAN;
}

/* Copies derivatives of one instant to their place among all of them; NaN where bodies have none. */
static void
copy_derivatives(const Frames *f, const Call *call, Results *r)
{
    long long orders = call->orders, bodies = f->bodies, t = r->count;
    const double *from = call->results;
    double *to = r->derivatives;
    const unsigned char *missing = r->missing + t * bodies;
    for (long long k = 0; k < 2 * orders + 2 * orders * orders + 2; k++) {
        long long size = k < orders ? 2 : 1;
        for (long long i = 0; i < size * bodies; i++)
            to[t * size * bodies + i] = missing[i / size] > NOT_FULL ? NAN : from[i];
        from += size * bodies, to += r->instants * size * bodies;
    }
}

/* Computes the result of the frame in row `now` from the window of those from `oldest` on. */
static int
compute_result(const Frames *f, Call *call, Results *r, Room *room, long long oldest, long long now)
{
    long long bodies = f->bodies, newest = f->end - 1, t = r->count, deformed = 0;
    for (long long b = 0; b < bodies; b++) {
        long long to = t * bodies + b;
        int pinned = holds_on_pin(f, oldest, b);
        r->pin[to] = pinned ? f->pin[b] : NAN + I * NAN;
        r->pin_variance[to] = pinned ? f->pin_variance[b] : NAN;
        room->hub[b] = pinned ? 0.0 : f->hub[b];
    }
    int tilts = fill_room(f, oldest, room);
    call->frames = f->end - oldest, call->bodies = bodies;
    room->frames[0] = now - oldest, room->frames[1] = 0, room->frames[2] = newest - oldest;
    call->time = f->time + oldest, call->turns = f->turns + oldest * bodies;
    call->windows = room->frames, call->left_out = f->newest;
    call->angle = room->angle, call->position = (const double *)room->position;
    call->angle_information = room->turn_information;
    call->position_information = room->place_information;
    call->noise = f->noise, call->results = room->found, call->next = 0;
    int code = kinpole_derive(call);
    if (code)
        return code;
    if (tilts) {
        /* The angle itself is the heading; the hub has turned by the other. */
        double *angle = room->found + 2 * call->orders * bodies;
        for (long long b = 0; b < bodies; b++)
            room->hub[b] *= isnan(angle[b]) ? 1.0 : unit_at(angle[b]);
        call->angle = room->heading, call->next = 0;
        long long size = (3 * call->orders + 2 * call->orders * call->orders + 2) * bodies;
        call->results = room->found + size;
        code = kinpole_derive(call);
        if (code)
            return code;
        const double *heading = call->results + 2 * call->orders * bodies;
        for (long long b = 0; b < bodies; b++) {
            room->hub[b] *= isnan(heading[b]) ? 1.0 : conj(unit_at(heading[b]));
            angle[b] = heading[b];
        }
        call->results = room->found;
    }
    for (long long b = 0; b < bodies; b++) {
        long long at = now * bodies + b, to = t * bodies + b, orders = call->orders;
        const double *information = f->information + 2 * now * bodies + b;
        int seen = information[0] > 0.0 && information[bodies] > 0.0 && now <= newest - f->newest[b];
        const double *rate = room->found + (2 * orders + 1) * bodies + b;
        const double *velocity = room->found + 2 * (bodies + b);
        int found = isfinite(*rate) && isfinite(velocity[0]) && isfinite(velocity[1]);
        int missing = !seen ? NOT_SEEN : f->unusable[b];
        r->missing[to] = missing ? missing : found ? KNOWN : NOT_FULL;
        r->size[to] = f->size[b], r->height[to] = f->height[at];
        r->reference[to] = room->hub[b];
        r->angle[to] = f->angle[at] + 6.283185307179586 * f->turns[at];
        r->position[to] = f->position[at];
        r->noise[to] = f->noise[b];
        r->middle[to] = f->posed ? f->middle[b] : middle_of_used(f, now, b);
        for (int c = 0; c < 2; c++)
            r->information[(2 * t + c) * bodies + b] =
                seen ? information[c * bodies] * f->scale[c * bodies + b] : 0.0;
        deformed |= r->missing[to] == KNOWN && f->freedom[b] > 0.0;
    }
    copy_derivatives(f, call, r);
    memcpy(r->shape + t * bodies * f->markers, f->known_shape,
           bodies * f->markers * sizeof *r->shape);
    r->stamp[t] = f->stamp[now], r->due[t] = f->frame - 1;
    r->count++;
    return deformed ? DEFORMED : DONE;
}

/* Computes the results that fall due with the newest frame. */
static int
compute_due(Frames *f, Call *call, Results *r)
{
    if (f->end == f->first)
        return DONE;
    long long newest = f->end - 1, oldest;
    oldest = f->first + number_before(f, f->time[newest] - f->window);
    f->samples = newest - oldest + 1;
    f->interval = (double)(f->time[newest] - f->time[oldest]) / (f->samples > 1 ? f->samples - 1 : 1);
    long long before = f->time[newest] - (long long)rint(f->lag - 0.75 * f->interval);
    long long end = number_before(f, before + 1);
    int code = DONE;
    if (f->due < end && r->instants && newest - oldest >= r->fewest - 1) {
        if (f->first + f->due < oldest)
            f->due = oldest - f->first;
        /* Twice the derivatives, for bodies that tilt. */
        long long all = (f->end - oldest) * f->bodies;
        long long found = 2 * (3 * call->orders + 2 * call->orders * call->orders + 2) * f->bodies;
        Room room;
        double *data = malloc((6 * all + found + 2 * f->bodies) * sizeof *data);
        if (!data)
            return NO_MEMORY;
        room.position = (Number *)data, room.hub = (Number *)(data + 2 * all);
        room.angle = data + 2 * all + 2 * f->bodies, room.heading = room.angle + all;
        room.turn_information = room.heading + all;
        room.place_information = room.turn_information + all;
        room.found = room.place_information + all;
        for (; !code && f->due < end; ) {
            if (r->count == r->instants) {
                code = FULL;
                break;
            }
            code = compute_result(f, call, r, &room, oldest, f->first + f->due);
            if (code == DONE || code == DEFORMED)
                f->due++;
        }
        free(data);
        if (code)
            return code;
    }
    f->due = end > f->due ? end : f->due;
    return DONE;
}

/* Takes frames as long as they are usual, and computes the results that fall due. Returns 0, or why
   it is to be called again once step.py has done its part. */
int
kinpole_follow(Frames *f, Call *call, Results *r)
{
    for (;;) {
        int code = compute_due(f, call, r);
        if (code || f->frame == f->frames || f->until_update <= 0)
            return code;
        code = take(f);
        if (code)
            return code;
    }
}
