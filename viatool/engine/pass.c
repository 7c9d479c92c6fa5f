/* The forward pass: a box through the nodes of the trunk, see K2 to K4. */
#include <string.h>

#include "kernel.h"

void *take(Arena *arena, size_t count) {
    const size_t bytes = (count * 8 + 63) & ~(size_t)63;
    if (arena->used + bytes > arena->size) return NULL; /* never: arena_size counts every array */
    void *memory = arena->memory + arena->used;
    arena->used += bytes;
    return memory;
}

integer symbols_of(const Network *net) {
    integer symbols = net->node[0].size;
    for (integer k = 0; k < net->trunk; k++)
        if (net->node[k].kind == ACTIVATION) symbols += net->node[k].size;
    return symbols;
}

size_t arena_size(const Network *net, integer shared) {
    const size_t symbols = (size_t)padded(symbols_of(net) + shared) + 8;
    size_t count = 4096;
    for (integer k = 0; k < net->trunk; k++) {
        count += (size_t)net->node[k].size * (symbols + 40) + 512;
        for (integer s = 0; s < net->node[k].sources; s++)
            count += 8 * (size_t)net->node[net->source[net->node[k].source + s].node].size;
    }
    return 64 * (count / 8);
}

static void begin(Model *model, integer size, Arena *arena) {
    const size_t count = (size_t)padded(size);
    double *block = take(arena, 6 * count);
    model->constant = block, model->rest = block + count, model->norm = block + 2 * count;
    model->lower = block + 3 * count, model->upper = block + 4 * count, model->size = block + 5 * count;
    memset(block, 0, 6 * count * 8);
    model->radius = take(arena, count), model->neuron = take(arena, count);
    model->rows = NULL;
    model->width = model->stride = model->first = model->fresh = 0;
}

static void enclose_input(const Network *net, Model *model, const double *lower, const double *upper) {
    for (integer i = 0; i < net->node[0].size; i++) {
        model->lower[i] = lower[i], model->upper[i] = upper[i];
        if (lower[i] == upper[i]) {
            model->constant[i] = lower[i];
            continue;
        }
        const double centre = lower[i] / 2 + upper[i] / 2;
        const double radius = outward(net, most(upper[i] - centre, centre - lower[i])) + LEAST * net->allow->underflow;
        model->constant[i] = centre, model->norm[i] = radius;
        model->neuron[model->fresh] = i, model->radius[model->fresh++] = radius;
    }
}

static void enclose_together(const Network *net, Model *model, const Inputs *inputs, Arena *arena) {
    const integer size = net->node[0].size;
    model->width = model->first = inputs->shared, model->stride = padded(inputs->shared);
    if (model->width) model->rows = take(arena, (size_t)(size * model->stride));
    for (integer i = 0; i < size; i++) {
        model->constant[i] = inputs->constant[i], model->rest[i] = inputs->rest[i], model->norm[i] = inputs->norm[i];
        model->lower[i] = inputs->lower[i], model->upper[i] = inputs->upper[i];
        for (integer s = 0; s < model->stride; s++)
            model->rows[i * model->stride + s] = s < model->width ? inputs->rows[s * size + i] : 0.0;
        if (inputs->own[i] != 0.0) model->neuron[model->fresh] = i, model->radius[model->fresh++] = inputs->own[i];
    }
}

/* Each neuron reads one number, times its own weight: the symbols stay where they are. */
static void enclose_scaled(const Network *net, const Node *node, const Source *source, const Model *in, Model *out,
                           double *sums, double *given, Arena *arena) {
    const integer size = node->size, stride = padded(size) + 1, each = padded(size);
    const double *w = net->numbers + source->weight, *a = net->numbers + source->absolute;
    const double *m = net->numbers + source->merged;
    give(in, each, 1.0 + SLIGHTLY * net->allow->sums, given, size);
    for (integer i = 0; i < size; i++) {
        const double matrix[SUMS] = {w[i * stride], m[i * stride], a[i * stride], w[i * stride], a[i * stride],
                                     m[i * stride]};
        for (integer k = 0; k < SUMS; k++) sums[k * each + i] = matrix[k] * given[k * size + i];
    }
    out->width = in->width, out->stride = in->stride, out->first = in->first, out->fresh = in->fresh;
    if (in->width) out->rows = take(arena, (size_t)(size * out->stride));
    for (integer i = 0; in->width && i < size; i++)
        scaled_row(out->rows + i * out->stride, in->rows + i * in->stride, w[i * stride], out->stride);
    for (integer k = 0; k < in->fresh; k++) {
        out->neuron[k] = in->neuron[k];
        out->radius[k] = in->radius[k] * w[in->neuron[k] * stride];
    }
}

static void enclose_dense(const Network *net, const Node *node, const Model *models, Model *out, double *sums,
                          double *given, integer *active, Arena *arena) {
    const integer size = node->size;
    for (integer k = 0; k < node->sources; k++) {
        const Source *source = net->source + node->source + k;
        const Model *in = models + source->node;
        const integer width = in->fresh ? in->first + in->fresh : in->width;
        if (width > out->width) out->width = width;
    }
    out->stride = padded(out->width);
    if (out->width) {
        out->rows = take(arena, (size_t)(size * out->stride));
        memset(out->rows, 0, (size_t)(size * out->stride) * 8);
    }
    for (integer k = 0; k < node->sources; k++) {
        const Source *source = net->source + node->source + k;
        const Model *in = models + source->node;
        const integer columns = net->node[source->node].size;
        const double *w = net->numbers + source->weight;
        integer count = 0;
        give(in, padded(columns), 1.0 + SLIGHTLY * net->allow->sums, given, columns);
        for (integer j = 0; j < columns; j++)
            if (given[OF_SIZE * columns + j] != 0.0 || given[OF_SIZE_OF_MIDDLE * columns + j] != 0.0) active[count++] = j;
        six_sums(sums, padded(size), net->numbers + source->weight_t, net->numbers + source->absolute_t,
                 net->numbers + source->merged_t, given, columns, active, count);
        if (!in->width) count = 0;
        if (count && k == 0)
            multiply(out->rows, out->stride, size, w, padded(columns), in->rows, in->stride, in->stride, active, count);
        else if (count)
            for (integer i = 0; i < size; i++)
                for (integer a = 0; a < count; a++)
                    if (w[i * padded(columns) + active[a]] != 0.0)
                        add_scaled(out->rows + i * out->stride, in->rows + active[a] * in->stride,
                                   w[i * padded(columns) + active[a]], in->width);
        for (integer i = 0; in->fresh && i < size; i++)
            add_fanned(out->rows + i * out->stride + in->first, w + i * padded(columns), in->neuron, in->radius, in->fresh);
    }
}

static void meet_hull(Model *model, integer i, double low, double high) {
    if (low > model->lower[i]) model->lower[i] = low;
    if (high < model->upper[i]) model->upper[i] = high;
}

static int enclose_affine(const Network *net, integer index, const Model *models, Model *out, Arena *arena) {
    const Node *node = net->node + index;
    const integer size = node->size, each = padded(size);
    integer columns = 0;
    for (integer k = 0; k < node->sources; k++)
        if (net->node[net->source[node->source + k].node].size > columns)
            columns = net->node[net->source[node->source + k].node].size;
    double *sums = take(arena, (size_t)(SUMS * each)), *given = take(arena, (size_t)(SUMS * columns));
    integer *active = take(arena, (size_t)columns);
    memset(sums, 0, (size_t)(SUMS * each) * 8);
    if (node->elementwise)
        enclose_scaled(net, node, net->source + node->source, models + net->source[node->source].node, out, sums, given,
                       arena);
    else
        enclose_dense(net, node, models, out, sums, given, active, arena);
    const double *bias = net->numbers + node->bias, *bias_size = net->numbers + node->bias_size;
    const double gamma = net->figure[index].gamma * net->allow->sums, lost = LEAST * net->allow->underflow;
    for (integer i = 0; i < size; i++)
        out->norm[i] = out->width ? absolute_sum(out->rows + i * out->stride, out->width) : 0.0;
    for (integer k = 0; k < out->fresh; k++) out->norm[out->neuron[k]] += fabs(out->radius[k]);
    return conclude(out, each, size, sums, bias, bias_size, gamma, 1.0 + SLIGHTLY * net->allow->sums, lost);
}

/* One neuron of an activation; returns the slope of its line. */
static double enclose_neuron(const Network *net, const Curve *curve, const Model *in, Model *out, integer i,
                             double lower, double upper) {
    if (curve->relu && (lower >= 0.0 || upper <= 0.0)) { /* the argument itself, or 0: nothing is rounded */
        const int passes = lower >= 0.0;
        out->lower[i] = passes ? lower : 0.0, out->upper[i] = passes ? upper : 0.0;
        out->constant[i] = passes ? in->constant[i] : 0.0;
        out->norm[i] = passes ? in->norm[i] : 0.0, out->rest[i] = passes ? in->rest[i] : 0.0;
        return passes ? 1.0 : 0.0;
    }
    const Line line = line_on(net, curve, lower, upper);
    const double slope = line.slope, steep = fabs(slope);
    range_on(net, curve, lower, upper, out->lower + i, out->upper + i);
    out->constant[i] = slope == 0.0 ? line.constant : slope * in->constant[i] + line.constant;
    out->norm[i] = steep * in->norm[i], out->rest[i] = steep * in->rest[i];
    if (line.exact) return slope;
    const double magnitude = fabs(in->constant[i]) + in->norm[i] + in->rest[i];
    const double rounding = 4 * UNIT * net->allow->lines * (steep * magnitude + fabs(line.constant)) +
                            LEAST * net->allow->underflow;
    const double error = outward(net, line.error * net->allow->errors + line.rounding);
    if (error > 1e-9 * out->norm[i] + 1e-14) {
        out->neuron[out->fresh] = i, out->radius[out->fresh++] = error;
        out->rest[i] = outward(net, out->rest[i] + rounding);
        out->norm[i] = outward(net, out->norm[i] + error);
    } else
        out->rest[i] = outward(net, out->rest[i] + rounding + error);
    return slope;
}

static int enclose_activation(const Network *net, integer index, const Limits *limits, const Model *models, Model *out,
                              integer *symbols, Arena *arena) {
    const Node *node = net->node + index;
    const Model *in = models + net->source[node->source].node;
    const integer size = node->size;
    out->width = in->fresh ? in->first + in->fresh : in->width;
    out->stride = padded(out->width), out->first = *symbols;
    if (out->width) out->rows = take(arena, (size_t)(size * out->stride));
    double *slopes = take(arena, (size_t)size);
    int finite = 1;
    for (integer i = 0; i < size; i++) {
        double lower = in->lower[i], upper = in->upper[i];
        if (limits) {
            const double low = most(lower, limits->lower[node->offset + i]);
            const double high = least(upper, limits->upper[node->offset + i]);
            if (low <= high) lower = low, upper = high;
        }
        if (!is_known(net->curve + node->curve, lower, upper)) return 0;
        slopes[i] = enclose_neuron(net, net->curve + node->curve, in, out, i, lower, upper);
        finite &= is_finite(out->constant[i]) && is_finite(out->norm[i]) && is_finite(out->rest[i]);
        finite &= is_finite(out->lower[i]) && is_finite(out->upper[i]);
        if (!out->width) continue;
        double *row = out->rows + i * out->stride;
        memset(row, 0, (size_t)out->stride * 8);
        if (in->width && slopes[i] != 0.0) scaled_row(row, in->rows + i * in->stride, slopes[i], in->width);
    }
    for (integer k = 0; k < in->fresh; k++) /* what moved one neuron has a column now */
        out->rows[in->neuron[k] * out->stride + in->first + k] = slopes[in->neuron[k]] * in->radius[k];
    *symbols += out->fresh;
    return finite;
}

/* Meet the hulls of the arguments that an activation turns at with what back-substitution says of them. */
static void look_back(const Network *net, integer index, Model *models, Back *back) {
    const Node *node = net->node + index;
    const integer argument = net->source[node->source].node;
    if (net->node[argument].kind != AFFINE) return;
    for (integer k = 0; k < net->node[argument].sources; k++)
        if (net->source[net->node[argument].source + k].node == 0) return; /* what reads inputs alone is exact */
    const Model *model = models + argument;
    for (integer i = 0; i < node->size; i++)
        if (has_kink(net, net->curve + node->curve, model->lower[i], model->upper[i]))
            meet_back(net, models, argument, i, back);
}

/* The nodes behind the input, of which the model is there, with so many symbols. */
static int through(const Network *net, integer symbols, const Limits *limits, const Model *known, Model *models,
                   Back *back, Arena *arena) {
    for (integer index = 0; index < net->trunk; index++) {
        const Node *node = net->node + index;
        Model *model = models + index;
        if (index > 0) begin(model, node->size, arena);
        int finite = 1;
        if (back && node->kind == ACTIVATION) look_back(net, index, models, back), keep_strips(net, index, models, back);
        if (node->kind == AFFINE)
            finite = enclose_affine(net, index, models, model, arena);
        else if (node->kind == ACTIVATION)
            finite = enclose_activation(net, index, limits, models, model, &symbols, arena);
        for (integer i = 0; known && i < node->size; i++) meet_hull(model, i, known[index].lower[i], known[index].upper[i]);
        for (integer i = 0; i < node->size; i++) finite &= limits || model->lower[i] <= model->upper[i];
        if (!finite) return 0;
        if (back) keep_size(net, index, models, back);
    }
    for (integer i = 0; back && i < net->node[net->trunk - 1].size; i++) meet_back(net, models, net->trunk - 1, i, back);
    return 1;
}

int pass(const Network *net, const double *lower, const double *upper, const Limits *limits, const Model *known,
         Model *models, Back *back, Arena *arena) {
    arena->used = 0;
    begin(models, net->node[0].size, arena);
    enclose_input(net, models, lower, upper);
    return through(net, models->fresh, limits, known, models, back, arena);
}

int pass_on(const Network *net, const Inputs *inputs, Model *models, Arena *arena) {
    arena->used = 0;
    begin(models, net->node[0].size, arena);
    enclose_together(net, models, inputs, arena);
    return through(net, inputs->shared + models->fresh, NULL, NULL, models, NULL, arena);
}
