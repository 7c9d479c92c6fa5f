/* Activations: straight lines, or bent curves as Python has tabulated them, see K3 and K5.
 *
 * The grid of a bent curve has GRID_HALF units on each side of 0, cut into cells. Of each it holds a polynomial of
 * degree 5 for the value and one of degree 4 for the slope, both in the distance from the middle of the cell, and what they err by. Behind the grid
 * a line takes their place: slope, shift, error, and the least and the largest slope of the curve.
 */
#include "kernel.h"

enum { FALLING = -1, CONSTANT = 0, RISING = 1, UNKNOWN = 2 };
enum { GRID_HALF = 32, OF_CELL = 13, OF_TAIL = 5, NEWTON_STEPS = 5 };

static const double FAR = 1e6; /* up to where the lines behind the grid are known to hold */

typedef struct {
    double middle, error;
} Around;

static const double *tail_at(const Network *net, const Curve *curve, double x) {
    if (x >= -GRID_HALF && x <= GRID_HALF) return NULL;
    return net->tables + curve->tails + (x > 0 ? OF_TAIL : 0);
}

static const double *cell_at(const Network *net, const Curve *curve, double x, double *away) {
    const double steps = (double)curve->steps;
    integer cell = (integer)((x + GRID_HALF) * steps); /* rounded: the neighbour may be meant */
    const integer cells = 2 * GRID_HALF * curve->steps;
    if (cell >= cells) cell = cells - 1;
    if (x < (double)cell / steps - GRID_HALF && cell > 0) cell--;
    *away = x - (((double)cell + 0.5) / steps - GRID_HALF);
    return net->tables + curve->grid + OF_CELL * cell;
}

static Around enclose_value(const Network *net, const Curve *curve, double x) {
    const double *tail = tail_at(net, curve, x);
    if (tail) {
        const double moved = tail[0] == 0.0 ? 0.0 : tail[0] * x;
        return (Around){moved + tail[1], (tail[2] + 4 * UNIT * (fabs(moved) + fabs(tail[1]))) * net->allow->lines};
    }
    double t;
    const double *c = cell_at(net, curve, x, &t);
    const double value = ((((c[5] * t + c[4]) * t + c[3]) * t + c[2]) * t + c[1]) * t + c[0];
    return (Around){value, c[6] * net->allow->lines};
}

static Around enclose_slope(const Network *net, const Curve *curve, double x) {
    const double *tail = tail_at(net, curve, x);
    if (tail) return (Around){tail[3] / 2 + tail[4] / 2, outward(net, tail[4] - tail[3]) * net->allow->lines};
    double t;
    const double *c = cell_at(net, curve, x, &t);
    const double slope = (((c[11] * t + c[10]) * t + c[9]) * t + c[8]) * t + c[7];
    return (Around){slope, c[12] * net->allow->lines};
}

static integer cells_below(const Network *net, const Cells *cells, double x) {
    integer cell = 0;
    while (cell + 1 < cells->count && x > net->tables[cells->edges + cell + 1]) cell++;
    return cell;
}

static integer cells_up_to(const Network *net, const Cells *cells, double x) {
    integer cell = 0;
    while (cell + 1 < cells->count && x >= net->tables[cells->edges + cell + 1]) cell++;
    return cell;
}

/* The hull of what is known at both ends and of what lies between them. */
static void hull_over(const Network *net, const Cells *cells, double lower, double upper, Around left, Around right,
                      double *low, double *high) {
    const integer place = cells_below(net, cells, lower) * cells->count + cells_up_to(net, cells, upper);
    *low = least(least(left.middle - left.error, right.middle - right.error), net->tables[cells->lowest + place]);
    *high = most(most(left.middle + left.error, right.middle + right.error), net->tables[cells->highest + place]);
}

int is_known(const Curve *curve, double lower, double upper) {
    return curve->pieces ? is_finite(lower) && is_finite(upper) : lower >= -FAR && upper <= FAR;
}

double value_on(const Network *net, const Curve *curve, double x) {
    if (curve->relu) return x > 0.0 ? x : 0.0;
    return curve->pieces ? value_on_lines(net, curve, x) : enclose_value(net, curve, x).middle;
}

double slope_on(const Network *net, const Curve *curve, double x) {
    if (curve->relu) return x >= 0.0 ? 1.0 : 0.0;
    if (curve->pieces) return net->tables[curve->slopes + piece_at(net, curve, x)];
    return enclose_slope(net, curve, x).middle;
}

void range_on(const Network *net, const Curve *curve, double lower, double upper, double *low, double *high) {
    if (curve->relu)
        *low = most(lower, 0.0), *high = most(upper, 0.0);
    else if (curve->pieces)
        range_on_lines(net, curve, lower, upper, low, high);
    else
        hull_over(net, &curve->values, lower, upper, enclose_value(net, curve, lower), enclose_value(net, curve, upper),
                  low, high);
}

void slopes_on(const Network *net, const Curve *curve, double lower, double upper, double *low, double *high) {
    if (curve->relu)
        *low = lower > 0.0 ? 1.0 : 0.0, *high = upper >= 0.0 ? 1.0 : 0.0;
    else if (curve->pieces)
        slopes_on_lines(net, curve, lower, upper, low, high);
    else
        hull_over(net, &curve->derivative, lower, upper, enclose_slope(net, curve, lower),
                  enclose_slope(net, curve, upper), low, high);
}

int has_kink(const Network *net, const Curve *curve, double lower, double upper) {
    for (integer k = 0; k < curve->kinks; k++)
        if (net->tables[curve->breaks + k] >= lower && net->tables[curve->breaks + k] <= upper) return 1;
    return 0;
}

static double picked_slope(const Network *net, const Curve *curve, double lower, double upper) {
    const double span = upper - lower, middle = lower / 2 + upper / 2;
    if (!(span > 1e-9 * (fabs(lower) + fabs(upper)) + 1e-200)) return slope_on(net, curve, middle);
    const integer first = cells_below(net, &curve->derivative, lower);
    const integer last = cells_up_to(net, &curve->derivative, upper);
    const int both_ways = first != last && !has_kink(net, curve, lower, upper);
    const double half = both_ways ? sqrt(0.75) * span / 2 : span / 2; /* bent both ways: the Chebyshev nodes */
    return (value_on(net, curve, middle + half) - value_on(net, curve, middle - half)) / (2 * half);
}

/* Bound sign (f(x) - slope x), convex on [left, right], from below by a tangent near its least point. */
static double tangent_bound(const Network *net, const Curve *curve, double left, double right, double slope, int sign) {
    double low = left, high = right, point = left / 2 + right / 2;
    for (int step = 0; step < NEWTON_STEPS; step++) {
        const double excess = sign * (slope_on(net, curve, point) - slope);
        if (excess < 0) low = point;
        if (excess > 0) high = point;
        const double apart = 1e-3 * (right - left);
        const double bend = sign * (slope_on(net, curve, point + apart) - slope_on(net, curve, point - apart)) / (2 * apart);
        const double next = point - excess / bend;
        const double before = point;
        point = next >= low && next <= high ? next : low / 2 + high / 2;
        if (fabs(point - before) <= 1e-6 * (right - left)) break;
    }
    point = least(most(point, left), right);
    const Around value = enclose_value(net, curve, point), derivative = enclose_slope(net, curve, point);
    const double tilted = sign * (value.middle - slope * point), steep = sign * (derivative.middle - slope);
    const double drop = least(least((steep - derivative.error) * (right - point), -(steep + derivative.error) * (point - left)), 0.0);
    const double size = fabs(value.middle) + fabs(slope * point) + (fabs(derivative.middle) + fabs(slope)) * (right - left);
    return tilted + drop - value.error - 8 * UNIT * net->allow->lines * size;
}

/* Extend what f(x) - slope x may be by a point. */
static void take_in(const Network *net, const Curve *curve, double x, double slope, double *low, double *high) {
    const Around value = enclose_value(net, curve, x);
    const double tilted = value.middle - slope * x;
    const double slack = value.error + 4 * UNIT * net->allow->lines * (fabs(value.middle) + fabs(slope * x));
    *low = least(*low, tilted - slack), *high = most(*high, tilted + slack);
}

static Residual residual_on_curve(const Network *net, const Curve *curve, double lower, double upper, double slope) {
    const Cells *cells = &curve->derivative;
    const integer first = cells_below(net, cells, lower), last = cells_up_to(net, cells, upper);
    double low = INFINITY, high = -INFINITY;
    for (integer k = first; k <= last; k++) {
        const double left = k > first ? net->tables[cells->edges + k] : lower;
        const double right = k < last ? net->tables[cells->edges + k + 1] : upper;
        const double kind = net->tables[cells->kinds + k];
        take_in(net, curve, left, slope, &low, &high);
        take_in(net, curve, right, slope, &low, &high);
        if (kind == RISING && right > left) low = least(low, tangent_bound(net, curve, left, right, slope, 1));
        if (kind == FALLING && right > left) high = most(high, -tangent_bound(net, curve, left, right, slope, -1));
        if (kind == UNKNOWN) { /* from the left end on the residual keeps to its slopes */
            double from = INFINITY, to = -INFINITY;
            take_in(net, curve, left, slope, &from, &to);
            const double below = net->tables[cells->lowest + k * cells->count + k] - slope;
            const double above = net->tables[cells->highest + k * cells->count + k] - slope;
            low = least(low, from + outward(net, least(below, 0.0) * (right - left)));
            high = most(high, to + outward(net, most(above, 0.0) * (right - left)));
        }
    }
    return (Residual){low, high};
}

Line line_on(const Network *net, const Curve *curve, double lower, double upper) {
    if (curve->pieces) return line_on_lines(net, curve, lower, upper);
    double slope = picked_slope(net, curve, lower, upper);
    if (!is_finite(slope)) slope = 0.0;
    const Residual residual = residual_on_curve(net, curve, lower, upper, slope);
    const double low = residual.low, high = residual.high, constant = low / 2 + high / 2;
    return (Line){slope, constant, outward(net, most(high - constant, constant - low)),
                  4 * UNIT * net->allow->lines * fabs(constant), 0};
}

static void take_better(double slope, Residual residual, double middle, Strip *strip) {
    if (slope * middle + residual.low > strip->below * middle + strip->shift_below)
        strip->below = slope, strip->shift_below = residual.low;
    if (slope * middle + residual.high < strip->above * middle + strip->shift_above)
        strip->above = slope, strip->shift_above = residual.high;
}

/* Of slopes at the ends, between them and in the middle: of a convex curve the best ones are among these. */
Strip strip_on(const Network *net, const Curve *curve, double lower, double upper) {
    if (curve->relu && lower >= 0.0) return (Strip){1.0, 0.0, 1.0, 0.0};
    if (curve->relu && upper <= 0.0) return (Strip){0.0, 0.0, 0.0, 0.0};
    const double middle = lower / 2 + upper / 2, exact = net->allow->errors;
    if (curve->relu) {
        const double slope = upper / (upper - lower), rise = most(-slope * lower, upper - slope * upper);
        const double rounding = 4 * UNIT * net->allow->lines * (upper + slope * (upper - lower));
        return (Strip){middle > 0.0, 0.0, slope, (rise + rounding + LEAST * net->allow->underflow) * exact};
    }
    const Line line = line_on(net, curve, lower, upper);
    if (line.exact) return (Strip){line.slope, 0.0, line.slope, 0.0};
    const double spread = outward(net, line.error * exact + line.rounding);
    Strip strip = {line.slope, line.constant - spread, line.slope, line.constant + spread};
    double slopes[3] = {slope_on(net, curve, middle), 0.0, 0.0};
    integer count = 1;
    if (curve->pieces) slopes[0] = slope_on(net, curve, lower), slopes[count++] = slope_on(net, curve, upper);
    for (integer k = 0; k < count; k++) {
        if (!is_finite(slopes[k]) || slopes[k] == line.slope) continue;
        const Residual residual = curve->pieces ? residual_on_lines(net, curve, lower, upper, slopes[k])
                                                : residual_on_curve(net, curve, lower, upper, slopes[k]);
        take_better(slopes[k], residual, middle, &strip);
    }
    return strip;
}
