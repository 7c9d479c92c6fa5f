/* Monotone collapse: the gradient of one action over a box, and the face on which the action is largest, see K6. */
#include <string.h>

#include "kernel.h"

void through_affine(const Network *net, const Node *node, const double *centre, const double *radius, double gamma,
                    Gradient *gradient) {
    for (integer k = 0; k < node->sources; k++) {
        const Source *source = net->source + node->source + k;
        const Node *before = net->node + source->node;
        const integer size = before->size, each = padded(size);
        double *c = gradient->centre + before->offset, *r = gradient->radius + before->offset;
        if (node->elementwise) {
            for (integer i = 0; i < size; i++) {
                c[i] += net->numbers[source->weight + diagonal(i, size)] * centre[i];
                r[i] = outward(net, r[i] + net->numbers[source->absolute + diagonal(i, size)] * radius[i] +
                                        net->numbers[source->merged + diagonal(i, size)] * gamma *
                                            (fabs(centre[i]) + radius[i])) +
                       LEAST * net->allow->underflow;
            }
            continue;
        }
        double *sums = gradient->sums, *weights = gradient->weights;
        integer *active = gradient->active, count = 0;
        memset(sums, 0, (size_t)(3 * each) * 8);
        for (integer i = 0; i < node->size; i++) active[count] = i, count += centre[i] != 0.0 || radius[i] != 0.0;
        const int alike = source->merged == source->absolute;
        for (integer i = 0; i < node->size; i++)
            weights[i] = alike ? radius[i] + gamma * (fabs(centre[i]) + radius[i]) : fabs(centre[i]) + radius[i];
        add_rows(sums, each, net->numbers + source->weight, centre, active, count);
        if (!alike) add_rows(sums + each, each, net->numbers + source->absolute, radius, active, count);
        add_rows(sums + 2 * each, each, net->numbers + source->merged, weights, active, count);
        for (integer j = 0; j < size; j++) {
            c[j] += sums[j];
            const double spread = sums[each + j] + (alike ? 1.0 : gamma) * sums[2 * each + j];
            r[j] = outward(net, r[j] + spread) + LEAST * net->allow->underflow;
        }
    }
}

static int through_activation(const Network *net, const Node *node, const Model *argument, const double *centre,
                              const double *radius, Gradient *gradient) {
    const Node *before = net->node + net->source[node->source].node;
    double *c = gradient->centre + before->offset, *r = gradient->radius + before->offset;
    for (integer i = 0; i < node->size; i++) {
        if (centre[i] == 0.0 && radius[i] == 0.0) continue;
        double low, high;
        slopes_on(net, net->curve + node->curve, argument->lower[i], argument->upper[i], &low, &high);
        if (!is_finite(low) || !is_finite(high)) return 0;
        if (low == 0.0 && high == 0.0) continue;
        const double middle = low / 2 + high / 2, half = most(high - middle, middle - low);
        const double product = centre[i] * middle;
        const int exact = low == 1.0 && high == 1.0 && c[i] == 0.0;
        const double rounding = exact ? 0.0 : 4 * UNIT * net->allow->slopes * (fabs(product) + fabs(c[i]));
        c[i] += product;
        r[i] = outward(net, r[i] + fabs(centre[i]) * half + radius[i] * (fabs(middle) + half) + rounding) +
               LEAST * net->allow->underflow;
    }
    return 1;
}

/* Bound the gradient of sign times an action, at the places of the inputs; 0 where it has no bounds. */
static int bound_gradient(const Network *net, const Model *models, integer action, double sign, Gradient *gradient) {
    const Node *last = net->node + net->trunk - 1;
    memset(gradient->centre, 0, (size_t)(last->offset + last->size) * 8);
    memset(gradient->radius, 0, (size_t)(last->offset + last->size) * 8);
    gradient->centre[last->offset + action] = sign;
    for (integer index = net->trunk - 1; index > 0; index--) {
        const Node *node = net->node + index;
        const double *centre = gradient->centre + node->offset, *radius = gradient->radius + node->offset;
        if (node->kind == AFFINE)
            through_affine(net, node, centre, radius, net->figure[index].backward * net->allow->slopes, gradient);
        else if (!through_activation(net, node, models + net->source[node->source].node, centre, radius, gradient))
            return 0;
    }
    return 1;
}

int collapse(const Network *net, const Model *models, integer action, double sign, double *lower, double *upper,
             Gradient *gradient) {
    if (!bound_gradient(net, models, action, sign, gradient)) return 0;
    int shrank = 0;
    for (integer i = 0; i < net->node[0].size; i++) {
        if (lower[i] == upper[i]) continue;
        const double centre = gradient->centre[i], radius = gradient->radius[i];
        const int rises = centre >= radius, falls = -centre >= radius;
        if (rises)
            lower[i] = upper[i];
        else if (falls)
            upper[i] = lower[i];
        shrank |= rises || falls;
    }
    return shrank;
}
