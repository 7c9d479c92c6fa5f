/* Weak duality over the symbols: a convex activation of straight lines lies above each of them, see K7. */
#include <string.h>

#include "kernel.h"


/* Write a neuron's form in all `symbols`. */
static void form_of(const Model *model, integer i, double *form, integer symbols) {
    if (model->width) memcpy(form, model->rows + i * model->stride, (size_t)model->width * 8);
    memset(form + model->width, 0, (size_t)(symbols - model->width) * 8);
    for (integer k = 0; k < model->fresh; k++)
        if (model->neuron[k] == i) form[model->first + k] += model->radius[k];
}

/* The piece of the curve at one end of the argument's range, as a condition: y - slope x - intercept >= 0. */
static void add_piece(const Network *net, const Curve *curve, const Model *argument, const Model *value, integer i,
                      integer piece, int shape, Dual *dual) {
    const integer symbols = dual->symbols;
    double *form = dual->forms + dual->count * dual->stride;
    const double slope = net->tables[curve->slopes + piece], steep = fabs(slope);
    const double low = net->tables[curve->lowest + piece], high = net->tables[curve->highest + piece];
    const double intercept = low / 2 + high / 2;
    form_of(value, i, form, symbols);
    if (slope != 0.0) {
        form_of(argument, i, dual->scratch, symbols);
        add_scaled(form, dual->scratch, -slope, symbols);
    }
    if (shape < 0) scaled_row(form, form, -1.0, symbols);
    const double centre = shape * (value->constant[i] - slope * argument->constant[i] - intercept);
    const double size = fabs(value->constant[i]) + value->norm[i] + fabs(intercept) +
                        steep * (fabs(argument->constant[i]) + argument->norm[i]);
    dual->slack[dual->count] = outward(net, value->rest[i] + steep * argument->rest[i] + high - low +
                                                8 * UNIT * net->allow->tilts * size) +
                               LEAST * net->allow->underflow + centre;
    dual->count++;
}

static void add_conditions(const Network *net, const Model *models, integer index, Dual *dual) {
    const Node *node = net->node + index;
    const Model *value = models + index, *argument = models + net->source[node->source].node;
    const Curve *curve = net->curve + node->curve;
    const double *objective = dual->objective + value->first;
    double above = INFINITY;
    integer last = -1;
    for (integer n = 0; n < dual->neurons; n++) { /* those whose symbols weigh most, one after the other */
        double best = 0.0;
        integer chosen = -1;
        for (integer k = 0; k < value->fresh; k++) {
            const double weight = curve->bend ? -(double)curve->bend * objective[k] : fabs(objective[k]);
            if (weight > best && (weight < above || (weight == above && k > last))) best = weight, chosen = k;
        }
        if (chosen < 0) return;
        above = best, last = chosen;
        const integer i = value->neuron[chosen];
        const integer first = piece_at(net, curve, argument->lower[i]), end = piece_at(net, curve, argument->upper[i]);
        int rising = 1, falling = 1;
        for (integer k = first; k < end; k++) {
            const double step = net->tables[curve->slopes + k + 1] - net->tables[curve->slopes + k];
            rising &= step >= 0, falling &= step <= 0;
        }
        if (!rising && !falling) continue;
        add_piece(net, curve, argument, value, i, first, rising ? 1 : -1, dual);
        add_piece(net, curve, argument, value, i, end, rising ? 1 : -1, dual);
    }
}

typedef struct {
    double at, weight;
} Break;

/* The beta >= 0 that minimises slope beta + sum |form + beta direction|: a weighted median. Any answer is sound. */
static double best_multiplier(const double *form, const double *direction, double slope, integer symbols, Break *breaks) {
    integer count = 0;
    double rising = slope;
    for (integer s = 0; s < symbols; s++) {
        const double weight = fabs(direction[s]);
        if (!(weight > 1e-290)) continue;
        const double at = -form[s] / direction[s];
        if (at > 0.0)
            rising -= weight, breaks[count++] = (Break){at, weight};
        else
            rising += weight;
    }
    if (rising >= 0.0) return 0.0;
    integer from = 0, to = count; /* the breaks before `from` are passed, and count in rising */
    while (to - from > 1) {
        const double pivot = breaks[from + (to - from) / 2].at;
        integer low = from, high = to;
        double passed = 0.0;
        for (integer k = from; k < high;) {
            if (breaks[k].at < pivot) {
                const Break one = breaks[k];
                passed += 2 * one.weight, breaks[k++] = breaks[low], breaks[low++] = one;
            } else if (breaks[k].at > pivot) {
                const Break one = breaks[k];
                breaks[k] = breaks[--high], breaks[high] = one;
            } else
                k++;
        }
        if (rising + passed >= 0.0) {
            to = low;
            continue;
        }
        double equal = 0.0;
        for (integer k = low; k < high; k++) equal += 2 * breaks[k].weight;
        if (rising + passed + equal >= 0.0) return pivot;
        rising += passed + equal, from = high;
    }
    if (to - from == 1 && rising + 2 * breaks[from].weight >= 0.0) return breaks[from].at;
    return 0.0; /* falls for ever: no symbols meet the condition */
}

void improve(Dual *dual, integer sweeps) {
    Break *breaks = (Break *)dual->breaks;
    memset(dual->beta, 0, (size_t)dual->count * 8);
    memcpy(dual->tilted, dual->objective, (size_t)dual->symbols * 8);
    for (integer sweep = 0; sweep < (dual->count > 1 ? sweeps : 1); sweep++)
        for (integer d = 0; d < dual->count; d++) {
            const double *direction = dual->forms + d * dual->stride;
            if (dual->beta[d] != 0.0) add_scaled(dual->tilted, direction, -dual->beta[d], dual->symbols);
            dual->beta[d] = best_multiplier(dual->tilted, direction, dual->slack[d], dual->symbols, breaks);
            if (!is_finite(dual->beta[d])) dual->beta[d] = 0.0;
            if (dual->beta[d] != 0.0) add_scaled(dual->tilted, direction, dual->beta[d], dual->symbols);
        }
}

/* The bound that multipliers prove, whatever they are. */
double proved_value(const Network *net, Dual *dual) {
    memcpy(dual->tilted, dual->objective, (size_t)dual->symbols * 8);
    double size = fabs(dual->constant) + absolute_sum(dual->objective, dual->symbols), slack = 0.0;
    for (integer d = 0; d < dual->count; d++) {
        if (!(dual->beta[d] > 0.0)) continue; /* what is no multiplier proves nothing */
        const double *form = dual->forms + d * dual->stride;
        add_scaled(dual->tilted, form, dual->beta[d], dual->symbols);
        size += dual->beta[d] * (absolute_sum(form, dual->symbols) + fabs(dual->slack[d]));
        slack += dual->beta[d] * dual->slack[d];
    }
    const double terms = (double)(2 * (dual->symbols + dual->count) + 8);
    const double rounding = outward(net, 1.5 * terms * UNIT * net->allow->tilts * size) + LEAST * net->allow->underflow;
    return dual->constant + slack + absolute_sum(dual->tilted, dual->symbols) + rounding;
}

void begin_dual(const Network *net, const Model *models, integer action, double sign, Dual *dual) {
    const Model *last = models + net->trunk - 1;
    dual->symbols = models[0].fresh, dual->count = 0;
    for (integer k = 0; k < net->trunk; k++)
        if (net->node[k].kind == ACTIVATION) dual->symbols += models[k].fresh;
    form_of(last, action, dual->objective, dual->symbols);
    scaled_row(dual->objective, dual->objective, sign, dual->symbols);
    dual->constant = sign * last->constant[action] + last->rest[action];
}

/* The argument of an activation lies on one side of a threshold: side (x - threshold) >= 0. */
void add_known(const Network *net, const Model *argument, integer i, double side, double threshold, Dual *dual) {
    double *form = dual->forms + dual->count * dual->stride;
    form_of(argument, i, form, dual->symbols);
    if (side < 0) scaled_row(form, form, -1.0, dual->symbols);
    const double size = fabs(argument->constant[i]) + argument->norm[i] + fabs(threshold);
    const double spare = outward(net, argument->rest[i] + 8 * UNIT * net->allow->tilts * size);
    dual->slack[dual->count++] = side * (argument->constant[i] - threshold) + spare;
}

void add_pieces(const Network *net, const Model *models, Dual *dual) {
    for (integer k = 0; k < net->trunk; k++)
        if (net->node[k].kind == ACTIVATION && net->curve[net->node[k].curve].pieces) add_conditions(net, models, k, dual);
}

double bound_by_duality(const Network *net, const Model *models, integer action, double sign, integer sweeps, Dual *dual) {
    begin_dual(net, models, action, sign, dual);
    add_pieces(net, models, dual);
    improve(dual, sweeps);
    const double bound = proved_value(net, dual);
    return bound == bound ? bound : INFINITY;
}
