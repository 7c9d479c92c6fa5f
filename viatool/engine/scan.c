/* Bins of a LiDAR as forms relative to what is nearest at the middle pose, and the gaps that they never read. */
#include <fenv.h>
#include <stdlib.h>
#include <string.h>

#include "scan.h"

#define EXPORTED __attribute__((visibility("default")))
#define NARROW 1e-6 /* metres up to which a gap is none, but rounding */

static double size_of(const double *slope) { return fabs(slope[0]) + fabs(slope[1]) + fabs(slope[2]); }

/* Bounds of what a ray reads of a shape that it meets, whatever the pose. */
static double nearest_end(const Glimpse *one) { return most(one->lower - size_of(one->slope), one->least); }
static double farthest_end(const Glimpse *one) { return least(one->upper + size_of(one->slope), one->most); }

/* Keeps what may be read at poses that count: bins then read between two numbers each. */
static void keep_within(Glimpses *seen, const double *lower, const double *upper, double slack) {
    integer kept = 0;
    for (integer t = 0; t < seen->count; t++) {
        const Glimpse *one = seen->glimpse + t;
        const int nearer = farthest_end(one) < lower[one->bin] - slack;
        const int farther = nearest_end(one) > upper[one->bin] + slack;
        if (!nearer && !farther) seen->glimpse[kept++] = *one;
    }
    seen->count = kept;
}

/* One bin relative to its reference: what a range exceeds `slope . pose` by. */
typedef struct {
    double middle, slope[3], low, high, met;
    int nearer; /* whether poses count only where it reads less than the maximum range */
} Bin;

static double value_of(const Glimpse *one, const Bin *bin) {
    return bin->nearer ? most(one->lower, one->least) : one->nearest;
}

static void refer(const Fan *fan, const Glimpses *seen, Bin *bins) {
    for (integer t = 0; t < seen->count; t++) {
        Bin *bin = bins + seen->glimpse[t].bin;
        bin->middle = least(bin->middle, value_of(seen->glimpse + t, bin));
    }
    for (integer t = 0; t < seen->count; t++) {
        Bin *bin = bins + seen->glimpse[t].bin;
        const double value = value_of(seen->glimpse + t, bin);
        if (value <= bin->middle && value < fan->maximum) memcpy(bin->slope, seen->glimpse[t].slope, sizeof bin->slope);
    }
}

static void relate(const Fan *fan, const Glimpses *seen, Bin *bins) {
    for (integer k = 0; k < fan->bins; k++) {
        const double spread = size_of(bins[k].slope);
        bins[k].low = fan->maximum - spread, bins[k].high = fan->maximum + spread, bins[k].met = -INFINITY;
    }
    for (integer t = 0; t < seen->count; t++) {
        const Glimpse *one = seen->glimpse + t;
        Bin *bin = bins + one->bin;
        double difference[3];
        for (int axis = 0; axis < 3; axis++) difference[axis] = one->slope[axis] - bin->slope[axis];
        const double apart = fan->leeway->apart * size_of(difference), around = size_of(bin->slope);
        const double farthest = least(one->upper + apart, one->most + around);
        bin->low = least(bin->low, most(one->lower - apart, one->least - around));
        if (one->certain) bin->high = least(bin->high, farthest);
        bin->met = most(bin->met, farthest);
    }
}

static void keep_bin_within(Bin *bin, double lower, double upper) {
    const double spread = size_of(bin->slope);
    if (bin->nearer && bin->met > -INFINITY) bin->high = least(bin->high, bin->met);
    bin->low = most(bin->low, lower - spread);
    bin->high = most(least(bin->high, upper + spread), bin->low); /* crossed where no pose counts */
}

/* Writes the form of bin k; one that may fall below the minimum range is lifted to it. */
static void write_form(const Fan *fan, const Bin *bin, double slack, integer k, double *centre, double *slope, double *rest) {
    const double low = bin->low - slack, high = bin->high + slack, spread = size_of(bin->slope);
    centre[k] = 0.5 * (low + high), rest[k] = 0.5 * (high - low) + slack;
    const int is_short = centre[k] - spread - rest[k] < fan->minimum;
    for (int axis = 0; axis < 3; axis++) slope[axis * fan->bins + k] = is_short ? 0.0 : bin->slope[axis];
    if (!is_short) return;
    const double lower = most(centre[k] - spread - rest[k], fan->minimum);
    const double upper = most(centre[k] + spread + rest[k], fan->minimum);
    centre[k] = 0.5 * (lower + upper), rest[k] = most(upper - centre[k], centre[k] - lower);
}

/* Forms (count, bins) of every bin over boxes (count, 3); windows (count, bins) say which poses count, or are NULL.
 * `done` is 0 for boxes that are left to numpy. */
EXPORTED int viatool_scan(const Fan *fan, integer count, const double *box_centre, const double *box_radius, double slack,
                          const double *lower, const double *upper, double *centre, double *slope, double *rest,
                          uint8_t *done) {
    Glimpses seen = {NULL, 0, 0};
    Bin *bins = malloc((size_t)fan->bins * sizeof(Bin));
    const int ready = bins && fegetround() == FE_TONEAREST;
    for (integer c = 0; ready && c < count; c++) {
        const integer at = c * fan->bins;
        done[c] = (uint8_t)look(fan, box_centre + 3 * c, box_radius + 3 * c, slack, &seen);
        if (!done[c]) continue;
        if (lower) keep_within(&seen, lower + at, upper + at, slack);
        for (integer k = 0; k < fan->bins; k++)
            bins[k] = (Bin){.middle = fan->maximum, .nearer = lower && upper[at + k] < fan->maximum - slack};
        refer(fan, &seen, bins);
        relate(fan, &seen, bins);
        for (integer k = 0; k < fan->bins; k++) {
            if (lower) keep_bin_within(bins + k, lower[at + k], upper[at + k]);
            write_form(fan, bins + k, slack, k, centre + at, slope + 3 * at, rest + at);
        }
    }
    free(bins), free(seen.glimpse);
    return ready;
}

/* What a bin may read of one shape. */
typedef struct {
    double least, most;
} Reading;

static int by_least(const void *a, const void *b) {
    const double first = ((const Reading *)a)->least, second = ((const Reading *)b)->least;
    return (first > second) - (first < second);
}

/* The widest gap between what a bin may read, of `count` readings and the most that it reads. */
static void widest_gap(Reading *readings, integer count, double cap, double *middle, double *width) {
    integer kept = 0;
    for (integer k = 0; k < count; k++)
        if (readings[k].least < cap) readings[kept++] = (Reading){readings[k].least, least(readings[k].most, cap)};
    if (!kept) return;
    qsort(readings, (size_t)kept, sizeof *readings, by_least);
    double reached = readings[0].most;
    for (integer k = 1; k <= kept; k++) {
        const double next = k < kept ? readings[k].least : cap, gap = next - reached;
        if (gap > NARROW && gap >= *width) *width = gap, *middle = 0.5 * (next + reached);
        if (k < kept) reached = most(reached, readings[k].most);
    }
}

/* The widest gap of each bin, (count, bins), where it lies and how wide it is; where it lies proves nothing. */
EXPORTED int viatool_gaps(const Fan *fan, integer count, const double *box_centre, const double *box_radius, double slack,
                          double *middle, double *width, uint8_t *done) {
    Glimpses seen = {NULL, 0, 0};
    Reading *readings = NULL;
    integer room = 0, *begin = malloc((size_t)(fan->bins + 1) * sizeof(integer));
    double *cap = malloc((size_t)fan->bins * sizeof(double));
    int ready = begin && cap && fegetround() == FE_TONEAREST;
    for (integer c = 0; ready && c < count; c++) {
        done[c] = (uint8_t)look(fan, box_centre + 3 * c, box_radius + 3 * c, slack, &seen);
        if (!done[c]) continue;
        if (seen.count > room) {
            free(readings);
            readings = malloc((size_t)(room = seen.count) * sizeof(Reading));
            if (!(ready = readings != NULL)) break;
        }
        memset(begin, 0, (size_t)(fan->bins + 1) * sizeof(integer));
        for (integer k = 0; k < fan->bins; k++) cap[k] = fan->maximum;
        for (integer t = 0; t < seen.count; t++) {
            const Glimpse *one = seen.glimpse + t;
            begin[one->bin + 1]++;
            if (one->certain) cap[one->bin] = least(cap[one->bin], farthest_end(one));
        }
        for (integer k = 0; k < fan->bins; k++) begin[k + 1] += begin[k];
        for (integer t = seen.count - 1; t >= 0; t--) {
            const Glimpse *one = seen.glimpse + t;
            readings[--begin[one->bin + 1]] = (Reading){nearest_end(one), farthest_end(one)};
        }
        for (integer k = 0; k < fan->bins; k++) { /* begin[k + 1] is now where bin k begins */
            const integer from = begin[k + 1], to = k + 1 < fan->bins ? begin[k + 2] : seen.count, at = c * fan->bins + k;
            middle[at] = width[at] = 0.0;
            widest_gap(readings + from, to - from, cap[k], middle + at, width + at);
        }
    }
    free(begin), free(cap), free(readings), free(seen.glimpse);
    return ready;
}
