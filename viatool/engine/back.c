/* Back-substitution: a row of weights from one neuron back to the inputs, through lines on both sides, see K11. */
#include <string.h>

#include "kernel.h"

integer back_size(const Network *net) { return 7 * net->neurons + 2 * padded(net->neurons) + net->nodes; }

Back begin_back(const Network *net, double *memory) {
    const integer n = net->neurons;
    double *next = memory + 7 * n;
    return (Back){{memory, memory + n, memory + 2 * n, memory + 3 * n, memory + 4 * n, memory + 5 * n}, memory + 6 * n,
                  next, (integer *)(void *)(next + padded(n)), next + 2 * padded(n)};
}

static double magnitude(const Model *model, integer i) { return most(fabs(model->lower[i]), fabs(model->upper[i])); }

void keep_size(const Network *net, integer index, const Model *models, Back *back) {
    double sum = index ? back->sizes[index - 1] : 0.0;
    for (integer i = 0; i < net->node[index].size; i++) sum += magnitude(models + index, i);
    back->sizes[index] = sum;
}

void keep_strips(const Network *net, integer index, const Model *models, Back *back) {
    const Node *node = net->node + index;
    const Model *argument = models + net->source[node->source].node;
    const Strips *strips = &back->strips;
    for (integer i = 0; i < node->size; i++) {
        const Strip strip = strip_on(net, net->curve + node->curve, argument->lower[i], argument->upper[i]);
        const integer at = node->offset + i;
        const double size = magnitude(argument, i);
        strips->above[at] = strip.above, strips->shift_above[at] = strip.shift_above;
        strips->below[at] = strip.below, strips->shift_below[at] = strip.shift_below;
        strips->size_above[at] = fabs(strip.above) * size + fabs(strip.shift_above);
        strips->size_below[at] = fabs(strip.below) * size + fabs(strip.shift_below);
    }
}

static Weighed follow_affine(const Network *net, const Node *node, const Model *model, Back *back) {
    const double *row = back->row + node->offset;
    integer count = 0;
    for (integer i = 0; i < node->size; i++) back->active[count] = i, count += row[i] != 0.0;
    for (integer k = 0; k < node->sources; k++) {
        const Source *source = net->source + node->source + k;
        const integer columns = net->node[source->node].size, each = padded(columns);
        double *before = back->row + net->node[source->node].offset;
        const double *w = net->numbers + source->weight;
        if (node->elementwise) {
            for (integer i = 0; i < columns; i++) before[i] += w[diagonal(i, columns)] * row[i];
            continue;
        }
        memset(back->sums, 0, (size_t)each * 8);
        add_rows(back->sums, each, w, row, back->active, count);
        for (integer j = 0; j < columns; j++) before[j] += back->sums[j];
    }
    return weigh(row, net->numbers + node->bias, model->size, node->size);
}

static Weighed follow_activation(const Network *net, const Node *node, Back *back) {
    const Strips *strips = &back->strips;
    const integer at = node->offset;
    const double *above[3] = {strips->above + at, strips->shift_above + at, strips->size_above + at};
    const double *below[3] = {strips->below + at, strips->shift_below + at, strips->size_below + at};
    double *before = back->row + net->node[net->source[node->source].node].offset;
    return weigh_by_sign(before, back->row + at, above, below, node->size);
}

/* Bound sign times one neuron from above; what is not a number proves nothing. */
double bound_back(const Network *net, const Model *models, integer index, integer neuron, double sign, Back *back) {
    const Node *last = net->node + index;
    memset(back->row, 0, (size_t)(last->offset + last->size) * 8);
    back->row[last->offset + neuron] = sign;
    double sum = 0.0, size = 0.0;
    for (integer k = index; k > 0; k--) {
        const Node *node = net->node + k;
        const Weighed part = node->kind == AFFINE ? follow_affine(net, node, models + k, back)
                                                  : follow_activation(net, node, back);
        sum += part.sum, size += part.size;
    }
    for (integer i = 0; i < net->node[0].size; i++) {
        const double one = back->row[i] * models[0].lower[i], other = back->row[i] * models[0].upper[i];
        sum += most(one, other), size += most(fabs(one), fabs(other));
    }
    const double lost = LEAST * net->allow->underflow * (1.0 + back->sizes[index]);
    return sum + 2 * net->gamma * net->allow->back * size + lost;
}

void meet_back(const Network *net, Model *models, integer index, integer neuron, Back *back) {
    const double high = bound_back(net, models, index, neuron, 1.0, back);
    const double low = -bound_back(net, models, index, neuron, -1.0, back);
    if (low > models[index].lower[neuron]) models[index].lower[neuron] = low;
    if (high < models[index].upper[neuron]) models[index].upper[neuron] = high;
}
