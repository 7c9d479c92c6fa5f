/* The core of a network over one box: decided neurons are straight lines there, and only those at a break stay, see K12. */
#include <string.h>

#include "kernel.h"

enum { MOST_KEPT = 128, MOST_ACTIONS = 64 };

static integer neurons_of_activations(const Network *net) {
    integer neurons = 0;
    for (integer k = 0; k < net->trunk; k++)
        if (net->node[k].kind == ACTIVATION) neurons += net->node[k].size;
    return neurons;
}

/* More kept neurons than this, and passes over the core would not be much shorter. */
static integer most_kept(const Network *net) {
    const integer half = neurons_of_activations(net) / 2;
    return half < MOST_KEPT ? half : MOST_KEPT;
}

static integer numbers_of(const Network *net) {
    const integer kept = most_kept(net), rows = kept + net->node[net->trunk - 1].size, pads = 8 * net->trunk;
    const integer columns = net->node[0].size + kept;
    return 3 * rows * (columns + pads) + 3 * columns * (rows + pads) + 2 * (rows + pads);
}

static int has_cores(const Network *net) {
    const Node *last = net->node + net->trunk - 1;
    for (integer k = 0; k < net->trunk; k++)
        if (net->node[k].kind == ACTIVATION && !net->curve[net->node[k].curve].pieces) return 0;
    return last->kind == AFFINE && last->size <= MOST_ACTIONS && net->trunk > 2;
}

integer core_size(const Network *net) {
    if (!has_cores(net)) return 0;
    const integer structs = (integer)(sizeof(Node) + sizeof(Figure) + sizeof(Model)) / 8 * net->trunk +
                            (integer)sizeof(Source) / 8 * net->trunk * net->trunk;
    const integer hulls = 2 * (net->node[0].size + 2 * most_kept(net) + net->node[net->trunk - 1].size);
    return structs + net->neurons + MOST_KEPT + 2 * net->trunk + 1 + hulls + numbers_of(net);
}

Core begin_core(const Network *net, double *memory) {
    Core core = {.most = has_cores(net) ? most_kept(net) : 0};
    if (!core.most) return core;
    char *next = (char *)memory;
    core.node = (Node *)(void *)next, next += sizeof(Node) * (size_t)net->trunk;
    core.figure = (Figure *)(void *)next, next += sizeof(Figure) * (size_t)net->trunk;
    core.known = (Model *)(void *)next, next += sizeof(Model) * (size_t)net->trunk;
    core.source = (Source *)(void *)next, next += sizeof(Source) * (size_t)(net->trunk * net->trunk);
    core.piece = (integer *)(void *)next;
    core.kept = core.piece + net->neurons, core.first = core.kept + MOST_KEPT, core.of = core.first + net->trunk + 1;
    core.hulls = (double *)(core.of + net->trunk);
    core.numbers = core.hulls + 2 * (net->node[0].size + 2 * core.most + net->node[net->trunk - 1].size);
    return core;
}

/* Find the piece that each neuron lies on, -1 where a break is between; tells whether few enough are kept. */
static int sort_neurons(const Network *net, const Model *models, Core *core) {
    integer count = 0;
    for (integer k = 0; k < net->trunk; k++) {
        const Node *node = net->node + k;
        core->first[k] = count;
        if (node->kind != ACTIVATION) continue;
        const Model *argument = models + net->source[node->source].node;
        for (integer i = 0; i < node->size; i++) {
            const integer piece = straight_piece(net, net->curve + node->curve, argument->lower[i], argument->upper[i]);
            core->piece[node->offset + i] = piece;
            if (piece >= 0) continue;
            if (count == core->most) return 0;
            core->kept[count++] = i;
        }
    }
    core->first[net->trunk] = count;
    return 1;
}

static double gamma_of(integer count) {
    const double product = (double)count * UNIT;
    return product / (1.0 - product) * (1.0 + SLIGHTLY);
}

static integer put(Core *core, integer count) {
    core->used += count;
    return core->used - count;
}

static Node *add_node(Core *core, integer kind, integer size, integer of) {
    Node *node = core->node + core->net.nodes;
    core->of[core->net.nodes++] = of;
    *node = (Node){.kind = kind, .size = size, .offset = core->net.neurons, .source = core->sources};
    core->net.neurons += size;
    return node;
}

/* An affine node reads the inputs and the kept neurons of all activations before. */
static void add_affine(const Network *net, integer of, integer size, Core *core) {
    const integer nodes = core->net.nodes;
    Node *node = add_node(core, AFFINE, size, of);
    integer columns = 0;
    node->bias = put(core, padded(size)), node->bias_size = put(core, padded(size));
    for (integer k = 0; k < nodes; k++) {
        if (core->node[k].kind == AFFINE) continue;
        const integer straight = size * padded(core->node[k].size), turned = core->node[k].size * padded(size);
        Source *source = core->source + core->sources++;
        *source = (Source){.node = k, .weight = put(core, straight), .absolute = put(core, straight),
                           .merged = put(core, straight), .weight_t = put(core, turned),
                           .absolute_t = put(core, turned), .merged_t = put(core, turned)};
        columns += core->node[k].size, node->sources++;
    }
    const integer readers = net->trunk, count = (columns > size ? columns : size) + 2 * readers + 10;
    const double gamma = gamma_of(count);
    core->figure[nodes] = (Figure){.gamma = gamma, .backward = gamma};
    if (count > core->roundings) core->roundings = count;
}

static void lay_out(const Network *net, Core *core) {
    const Node *last = net->node + net->trunk - 1;
    core->net = (Network){.node = core->node, .source = core->source, .curve = net->curve, .figure = core->figure,
                          .numbers = core->numbers, .tables = net->tables, .allow = net->allow};
    core->used = core->sources = core->roundings = 0;
    add_node(core, INPUT, net->node[0].size, 0);
    for (integer k = 0; k < net->trunk; k++) {
        const integer size = net->node[k].kind == ACTIVATION ? core->first[k + 1] - core->first[k] : 0;
        if (!size) continue;
        add_affine(net, k, size, core);
        Node *node = add_node(core, ACTIVATION, size, k);
        node->curve = net->node[k].curve, node->sources = 1;
        core->source[core->sources++] = (Source){.node = core->net.nodes - 2};
    }
    add_affine(net, net->trunk - 1, last->size, core);
    core->net.trunk = core->net.nodes, core->net.gamma = gamma_of(core->net.neurons + core->roundings);
}

/* What a row comes to besides its weights: a constant, and by how much that may be off. */
typedef struct {
    double sum, size, error;
} Rest;

static void follow_straight(const Network *net, const Node *node, const Core *core, Gradient *gradient, Rest *rest) {
    const Curve *curve = net->curve + node->curve;
    const integer before = net->node[net->source[node->source].node].offset;
    for (integer i = 0; i < node->size; i++) {
        const integer piece = core->piece[node->offset + i];
        const double centre = gradient->centre[node->offset + i], radius = gradient->radius[node->offset + i];
        if (piece < 0 || (centre == 0.0 && radius == 0.0)) continue;
        const double slope = net->tables[curve->slopes + piece], product = slope * centre;
        const double low = net->tables[curve->lowest + piece], high = net->tables[curve->highest + piece];
        double *c = gradient->centre + before + i, *r = gradient->radius + before + i;
        const double rounding = slope == 1.0 && *c == 0.0 ? 0.0 : 4 * UNIT * (fabs(product) + fabs(*c));
        *r = outward(net, *r + fabs(slope) * radius + rounding) + (slope == 0.0 ? 0.0 : LEAST);
        *c += product;
        rest->sum += centre * (low / 2 + high / 2);
        rest->size += (fabs(centre) + radius) * (fabs(low) + fabs(high));
        rest->error += radius * (fabs(low) + fabs(high)) + fabs(centre) * (high - low);
    }
}

/* The weights of one neuron in the inputs and the kept neurons, centre and radius at their places. */
static Rest follow_to_kept(const Network *net, integer index, integer neuron, const Core *core, Gradient *gradient) {
    const Node *last = net->node + index;
    memset(gradient->centre, 0, (size_t)(last->offset + last->size) * 8);
    memset(gradient->radius, 0, (size_t)(last->offset + last->size) * 8);
    gradient->centre[last->offset + neuron] = 1.0;
    Rest rest = {0.0, 0.0, 0.0};
    for (integer k = index; k > 0; k--) {
        const Node *node = net->node + k;
        if (node->kind == ACTIVATION) {
            follow_straight(net, node, core, gradient, &rest);
            continue;
        }
        const double *centre = gradient->centre + node->offset, *radius = gradient->radius + node->offset;
        const double *bias = net->numbers + node->bias, *bias_size = net->numbers + node->bias_size;
        for (integer i = 0; i < node->size; i++) {
            rest.sum += centre[i] * bias[i], rest.error += radius[i] * bias_size[i];
            rest.size += (fabs(centre[i]) + radius[i]) * bias_size[i];
        }
        through_affine(net, node, centre, radius, net->figure[k].backward, gradient);
    }
    return rest;
}

/* Write a number that is off by at most `radius`: as one whose size before it was rounded is so much larger. */
static int write_number(const Core *core, double centre, double radius, double gamma, double *number, double *size) {
    const double spare = outward(&core->net, radius * core->net.allow->core / gamma) + LEAST;
    *number = centre, *size = outward(&core->net, fabs(centre) + spare);
    return is_finite(centre) && is_finite(*size);
}

static int write_row(const Network *net, integer index, integer row, Rest rest, const Gradient *gradient, Core *core) {
    const Node *node = core->node + index;
    const double gamma = core->figure[index].gamma;
    const double spare = outward(net, rest.error + 2 * net->gamma * rest.size) + LEAST;
    double *numbers = core->numbers;
    int finite = write_number(core, rest.sum, spare, gamma, numbers + node->bias + row, numbers + node->bias_size + row);
    for (integer s = 0; s < node->sources; s++) {
        const Source *source = core->source + node->source + s;
        const integer columns = core->node[source->node].size, of = core->of[source->node];
        const integer *kept = core->kept + core->first[of];
        for (integer j = 0; j < columns; j++) {
            const integer at = net->node[of].offset + (source->node ? kept[j] : j);
            const integer straight = row * padded(columns) + j, turned = j * padded(node->size) + row;
            double *weight = numbers + source->weight + straight, *merged = numbers + source->merged + straight;
            finite &= write_number(core, gradient->centre[at], gradient->radius[at], gamma, weight, merged);
            numbers[source->absolute + straight] = numbers[source->absolute_t + turned] = fabs(*weight);
            numbers[source->weight_t + turned] = *weight, numbers[source->merged_t + turned] = *merged;
        }
    }
    return finite;
}

/* What the pass over the whole network knows of the nodes of the core. */
static void keep_hulls(const Network *net, const Model *models, Core *core) {
    double *next = core->hulls;
    for (integer k = 0; k < core->net.nodes; k++) {
        const Node *node = core->node + k;
        const integer of = core->of[k];
        const int reads = node->kind == AFFINE && net->node[of].kind == ACTIVATION; /* what a kept neuron reads */
        const Model *model = models + (reads ? net->source[net->node[of].source].node : of);
        const integer *kept = net->node[of].kind == ACTIVATION ? core->kept + core->first[of] : NULL;
        core->known[k].lower = next, core->known[k].upper = next + node->size, next += 2 * node->size;
        for (integer i = 0; i < node->size; i++) {
            core->known[k].lower[i] = model->lower[kept ? kept[i] : i];
            core->known[k].upper[i] = model->upper[kept ? kept[i] : i];
        }
    }
}

int find_core(const Network *net, const Model *models, Gradient *gradient, Core *core) {
    if (!core->most || !sort_neurons(net, models, core)) return 0;
    integer nodes = 2;
    for (integer k = 0; k < net->trunk; k++) nodes += core->first[k + 1] > core->first[k] ? 2 : 0;
    if (nodes > net->trunk) return 0;
    lay_out(net, core);
    memset(core->numbers, 0, (size_t)core->used * 8);
    for (integer k = 1; k < core->net.nodes; k++) {
        const Node *node = core->node + k;
        const integer of = core->of[k];
        if (node->kind != AFFINE) continue;
        for (integer i = 0; i < node->size; i++) {
            const int last = net->node[of].kind == AFFINE;
            const integer index = last ? of : net->source[net->node[of].source].node;
            const integer neuron = last ? i : core->kept[core->first[of] + i];
            if (!write_row(net, k, i, follow_to_kept(net, index, neuron, core, gradient), gradient, core)) return 0;
        }
    }
    keep_hulls(net, models, core);
    return 1;
}
