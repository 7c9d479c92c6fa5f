/* The inner side of a bound: values that are attained, found from corner to corner along the gradient. No bound. */
#include <string.h>

#include "kernel.h"

static void evaluate(const Network *net, const double *point, Search *search) {
    if (!memcmp(point, search->evaluated, (size_t)net->node[0].size * 8)) return;
    memcpy(search->evaluated, point, (size_t)net->node[0].size * 8);
    double *values = search->values;
    memcpy(values, point, (size_t)net->node[0].size * 8);
    for (integer index = 1; index < net->trunk; index++) {
        const Node *node = net->node + index;
        double *value = values + node->offset;
        if (node->kind == ACTIVATION) {
            const double *x = values + net->node[net->source[node->source].node].offset;
            for (integer i = 0; i < node->size; i++) value[i] = value_on(net, net->curve + node->curve, x[i]);
            continue;
        }
        memcpy(search->sum, net->numbers + node->bias, (size_t)node->size * 8);
        for (integer k = 0; k < node->sources; k++) {
            const Source *source = net->source + node->source + k;
            const double *x = values + net->node[source->node].offset;
            if (node->elementwise)
                for (integer i = 0; i < node->size; i++)
                    search->sum[i] += net->numbers[source->weight + diagonal(i, node->size)] * x[i];
            else
                add_product(search->sum, padded(node->size), net->numbers + source->weight_t, x,
                            net->node[source->node].size);
        }
        memcpy(value, search->sum, (size_t)node->size * 8);
    }
}

void forget(Search *search, integer inputs) {
    memset(search->evaluated, 0xff, (size_t)inputs * 8); /* not a number: nothing is evaluated yet */
}

/* The gradient of one action, times its sign, at what was evaluated; it stands before the other adjoints. */
static void differentiate(const Network *net, integer action, double sign, Search *search) {
    double *adjoints = search->adjoints;
    const Node *last = net->node + net->trunk - 1;
    memset(adjoints, 0, (size_t)(last->offset + last->size) * 8);
    adjoints[last->offset + action] = sign;
    for (integer index = net->trunk - 1; index > 0; index--) {
        const Node *node = net->node + index;
        const double *adjoint = adjoints + node->offset;
        for (integer k = 0; k < node->sources; k++) {
            const Source *source = net->source + node->source + k;
            const Node *before = net->node + source->node;
            double *pulled = adjoints + before->offset;
            if (node->kind == ACTIVATION)
                for (integer i = 0; i < node->size; i++) {
                    const double x = search->values[before->offset + i];
                    if (adjoint[i] != 0.0) pulled[i] += adjoint[i] * slope_on(net, net->curve + node->curve, x);
                }
            else if (node->elementwise)
                for (integer i = 0; i < node->size; i++)
                    pulled[i] += adjoint[i] * net->numbers[source->weight + diagonal(i, node->size)];
            else {
                memcpy(search->sum, pulled, (size_t)before->size * 8);
                add_product(search->sum, padded(before->size), net->numbers + source->weight, adjoint, node->size);
                memcpy(pulled, search->sum, (size_t)before->size * 8);
            }
        }
    }
}

double climb(const Network *net, const double *lower, const double *upper, integer action, double sign, integer steps,
             double bound, double *best, Search *search) {
    const Node *last = net->node + net->trunk - 1;
    const integer inputs = net->node[0].size;
    const double *values = search->values;
    double *point = search->point, *corner = search->corner;
    for (integer i = 0; i < inputs; i++) point[i] = best[i] = least(most(best[i], lower[i]), upper[i]);
    evaluate(net, point, search);
    double value = sign * values[last->offset + action];
    for (integer step = 0; step < steps && value < bound; step++) {
        evaluate(net, point, search);
        differentiate(net, action, sign, search);
        int moved = 0;
        for (integer i = 0; i < inputs; i++) {
            corner[i] = search->adjoints[i] > 0.0 ? upper[i] : search->adjoints[i] < 0.0 ? lower[i] : point[i];
            moved |= corner[i] != best[i];
        }
        if (!moved) break;
        evaluate(net, corner, search);
        const double reached = sign * values[last->offset + action];
        const int better = reached > value;
        if (better) value = reached, memcpy(best, corner, (size_t)inputs * 8);
        for (integer i = 0; i < inputs; i++) point[i] = better ? corner[i] : best[i] / 2 + corner[i] / 2;
    }
    return value;
}
