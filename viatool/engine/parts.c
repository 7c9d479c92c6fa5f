/* Parts of boxes: where the relaxation of a part is largest, and where to split it next. Neither is a bound. */
#include "kernel.h"

static const double RESERVE = 1e-3, LAST_RESERVE = 1e-9; /* of symbols that the multipliers have cancelled */

/* The kink inside an interval, or its middle. */
static double threshold_of(const Network *net, const Curve *curve, double lower, double upper) {
    double threshold = lower / 2 + upper / 2;
    for (integer k = 0; k < curve->kinks; k++) {
        const double kink = net->tables[curve->breaks + k];
        if (lower < kink && kink < upper) threshold = kink;
    }
    return threshold;
}

/* The neuron whose symbol weighs most; node 0 where no activation has an error left. */
Split next_split(const Network *net, const Model *models, const Limits *limits, const Dual *dual) {
    Split split = {0, 0, 0.0};
    double best = 0.0;
    for (integer index = 0; index < net->trunk; index++) {
        const Node *node = net->node + index;
        if (node->kind != ACTIVATION) continue;
        const Model *value = models + index, *argument = models + net->source[node->source].node;
        for (integer k = 0; k < value->fresh; k++) {
            const integer at = value->first + k, i = value->neuron[k];
            const double weight =
                fabs(dual->tilted[at]) + RESERVE * fabs(dual->objective[at]) + LAST_RESERVE * value->radius[k];
            if (!(weight > best)) continue;
            const double lower = most(argument->lower[i], limits->lower[node->offset + i]);
            const double upper = least(argument->upper[i], limits->upper[node->offset + i]);
            best = weight, split = (Split){index, i, threshold_of(net, net->curve + node->curve, lower, upper)};
        }
    }
    return split;
}

/* The point that symbols stand for. */
void relaxed_point(const Network *net, const Model *models, const double *e, const double *lower, const double *upper,
                   double *point) {
    for (integer i = 0; i < net->node[0].size; i++) point[i] = models[0].constant[i];
    for (integer k = 0; k < models[0].fresh; k++) point[models[0].neuron[k]] += e[k] * models[0].radius[k];
    for (integer i = 0; i < net->node[0].size; i++) point[i] = least(most(point[i], lower[i]), upper[i]);
}
