/* Activations of straight lines: the line that is closest on an interval, ranges and slopes, see K3. */
#include "kernel.h"

integer piece_at(const Network *net, const Curve *curve, double x) {
    const double *breaks = net->tables + curve->breaks;
    integer piece = 0;
    while (piece + 1 < curve->pieces && x >= breaks[piece]) piece++;
    return piece;
}

/* The piece that an interval ends with: one that only begins there is left out, since the curve is continuous. */
static integer piece_below(const Network *net, const Curve *curve, double x) {
    const double *breaks = net->tables + curve->breaks;
    integer piece = 0;
    while (piece + 1 < curve->pieces && x > breaks[piece]) piece++;
    return piece;
}

integer straight_piece(const Network *net, const Curve *curve, double lower, double upper) {
    const integer first = piece_at(net, curve, lower);
    return first >= piece_below(net, curve, upper) ? first : -1;
}

static integer later(integer one, integer other) { return one > other ? one : other; }

static double middle_shift(const Network *net, const Curve *curve, integer piece) {
    const double low = net->tables[curve->lowest + piece], high = net->tables[curve->highest + piece];
    return low / 2 + high / 2;
}

double value_on_lines(const Network *net, const Curve *curve, double x) {
    const integer piece = piece_at(net, curve, x);
    const double slope = net->tables[curve->slopes + piece];
    return (slope == 0.0 ? 0.0 : slope * x) + middle_shift(net, curve, piece);
}

/* What the computed value of a piece at x may be off by. */
static double slack_at(const Network *net, const Curve *curve, integer piece, double x) {
    if (!net->tables[curve->rounded + piece]) return 0.0;
    const double low = net->tables[curve->lowest + piece], high = net->tables[curve->highest + piece];
    const double moved = fabs(net->tables[curve->slopes + piece] * x);
    return net->allow->lines * (4 * UNIT * (moved + fabs(low) + fabs(high)) + (high - low)) + LEAST * net->allow->underflow;
}

/* The least and the largest of the computed residuals at both ends and what lies between: there the residual turns. */
static Residual turn_by_turn(const Network *net, const Curve *curve, double lower, double upper, double slope,
                             double *rounding) {
    const integer first = piece_at(net, curve, lower), last = later(first, piece_below(net, curve, upper));
    Residual found = {INFINITY, -INFINITY};
    *rounding = 0.0;
    for (integer k = first; k <= last + 1; k++) {
        const double x = k == first ? lower : k == last + 1 ? upper : net->tables[curve->breaks + k - 1];
        const integer piece = k == first ? first : k == last + 1 ? last : piece_at(net, curve, x);
        const double value = value_on_lines(net, curve, x), residual = value - slope * x;
        const double size = fabs(value) + fabs(slope * x);
        found.low = least(found.low, residual), found.high = most(found.high, residual);
        *rounding = most(*rounding, 4 * UNIT * net->allow->lines * size + slack_at(net, curve, piece, x));
    }
    return found;
}

Residual residual_on_lines(const Network *net, const Curve *curve, double lower, double upper, double slope) {
    double rounding;
    const Residual found = turn_by_turn(net, curve, lower, upper, slope, &rounding);
    const double slack = outward(net, rounding) + 4 * UNIT * net->allow->lines * (fabs(found.low) + fabs(found.high));
    return (Residual){found.low - slack, found.high + slack};
}

Line line_on_lines(const Network *net, const Curve *curve, double lower, double upper) {
    const integer first = piece_at(net, curve, lower), last = piece_below(net, curve, upper);
    if (first >= last) {
        const double slope = net->tables[curve->slopes + first], shift = middle_shift(net, curve, first);
        if (!net->tables[curve->rounded + first] && slope >= 0.0) return (Line){slope, 0.0, 0.0, 0.0, 1};
        const double low = net->tables[curve->lowest + first], high = net->tables[curve->highest + first];
        return (Line){slope, shift, 0.0, net->allow->lines * (high - low + 4 * UNIT * fabs(shift)), 0};
    }
    const double at_lower = value_on_lines(net, curve, lower), at_upper = value_on_lines(net, curve, upper);
    const double span = upper - lower;
    double slope = span > 0.0 ? (at_upper - at_lower) / span : 0.0;
    if (!is_finite(slope)) slope = 0.0;
    double rounding;
    const Residual residual = turn_by_turn(net, curve, lower, upper, slope, &rounding);
    const double low = residual.low, high = residual.high;
    const double constant = low / 2 + high / 2;
    const double error = outward(net, most(high - constant, constant - low));
    return (Line){slope, constant, error, outward(net, rounding + 4 * UNIT * net->allow->lines * fabs(constant)), 0};
}

void range_on_lines(const Network *net, const Curve *curve, double lower, double upper, double *low, double *high) {
    const integer first = piece_at(net, curve, lower), last = piece_at(net, curve, upper);
    *low = INFINITY, *high = -INFINITY;
    for (integer k = first; k <= last + 1; k++) {
        if (curve->rising && k != first && k != last + 1) continue;
        const double x = k == first ? lower : k == last + 1 ? upper : net->tables[curve->breaks + k - 1];
        const integer piece = piece_at(net, curve, x);
        const double value = value_on_lines(net, curve, x), slack = slack_at(net, curve, piece, x);
        *low = least(*low, value - slack), *high = most(*high, value + slack);
    }
}

/* Every generalised derivative: at an end on a break both sides count. */
void slopes_on_lines(const Network *net, const Curve *curve, double lower, double upper, double *low, double *high) {
    const integer first = piece_below(net, curve, lower), last = piece_at(net, curve, upper);
    *low = INFINITY, *high = -INFINITY;
    for (integer k = first; k <= last; k++) {
        const double slope = net->tables[curve->slopes + k];
        *low = least(*low, slope), *high = most(*high, slope);
    }
}
