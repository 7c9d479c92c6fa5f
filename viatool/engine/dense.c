/* Sums of products, in whatever order the processor likes best: K2 covers every order. */
#include "kernel.h"

typedef double eight __attribute__((vector_size(64), aligned(8), may_alias));

/* out[i] (width) = sum over active j of weight[i, j] in[j], for all rows i; widths are multiples of 8. */
EVERY_PROCESSOR
void multiply(double *out, integer stride, integer rows, const double *weight, integer columns, const double *in,
              integer in_stride, integer width, const integer *active, integer count) {
    for (integer i = 0; i < rows; i += 4) {
        const integer some = rows - i < 4 ? rows - i : 4;
        const double *w[4];
        for (integer k = 0; k < 4; k++) w[k] = weight + (i + (k < some ? k : 0)) * columns;
        integer s = 0;
        for (; s + 16 <= width; s += 16) {
            eight a0 = {0}, a1 = {0}, b0 = {0}, b1 = {0}, c0 = {0}, c1 = {0}, d0 = {0}, d1 = {0};
            for (integer k = 0; k < count; k++) {
                const integer j = active[k];
                const eight *x = (const eight *)(in + j * in_stride + s);
                const eight left = x[0], right = x[1];
                a0 += w[0][j] * left, a1 += w[0][j] * right;
                b0 += w[1][j] * left, b1 += w[1][j] * right;
                c0 += w[2][j] * left, c1 += w[2][j] * right;
                d0 += w[3][j] * left, d1 += w[3][j] * right;
            }
            eight *o = (eight *)(out + i * stride + s);
            o[0] = a0, o[1] = a1;
            if (some > 1) o = (eight *)((double *)o + stride), o[0] = b0, o[1] = b1;
            if (some > 2) o = (eight *)((double *)o + stride), o[0] = c0, o[1] = c1;
            if (some > 3) o = (eight *)((double *)o + stride), o[0] = d0, o[1] = d1;
        }
        if (s < width) {
            eight a = {0}, b = {0}, c = {0}, d = {0};
            for (integer k = 0; k < count; k++) {
                const integer j = active[k];
                const eight x = *(const eight *)(in + j * in_stride + s);
                a += w[0][j] * x, b += w[1][j] * x, c += w[2][j] * x, d += w[3][j] * x;
            }
            double *o = out + i * stride + s;
            *(eight *)o = a;
            if (some > 1) *(eight *)(o + stride) = b;
            if (some > 2) *(eight *)(o + 2 * stride) = c;
            if (some > 3) *(eight *)(o + 3 * stride) = d;
        }
    }
}

EVERY_PROCESSOR
void give(const Model *model, integer each, double outward, double *restrict given, integer columns) {
    const double *restrict block = model->constant;
    for (integer j = 0; j < columns; j++) {
        const double constant = block[j], rest = block[each + j], norm = block[2 * each + j];
        const double lower = block[3 * each + j], upper = block[4 * each + j];
        const double middle = lower / 2 + upper / 2;
        const double radius = most(upper - middle, middle - lower) * outward;
        given[OF_CONSTANT * columns + j] = constant, given[OF_SIZE * columns + j] = fabs(constant) + norm + rest;
        given[OF_REST * columns + j] = rest, given[OF_MIDDLE * columns + j] = middle;
        given[OF_REACH * columns + j] = radius, given[OF_SIZE_OF_MIDDLE * columns + j] = fabs(middle) + radius;
    }
}

EVERY_PROCESSOR
int conclude(Model *model, integer each, integer size, const double *restrict sums, const double *restrict bias,
             const double *restrict bias_size, double gamma, double outward, double lost) {
    double *restrict block = model->constant;
    int finite = 1;
    for (integer i = 0; i < size; i++) {
        const double constant = bias[i] + sums[OF_CONSTANT * each + i], norm = block[2 * each + i];
        const double rest = (sums[OF_REST * each + i] + gamma * (bias_size[i] + sums[OF_SIZE * each + i])) * outward + lost;
        const double middle = bias[i] + sums[OF_MIDDLE * each + i];
        const double spread = gamma * (bias_size[i] + sums[OF_SIZE_OF_MIDDLE * each + i]);
        const double reach = (sums[OF_REACH * each + i] + spread) * outward + lost;
        const double span = (norm + rest) * outward;
        const double lower = most(constant - span, middle - reach), upper = least(constant + span, middle + reach);
        block[i] = constant, block[each + i] = rest, block[3 * each + i] = lower, block[4 * each + i] = upper;
        block[5 * each + i] = (bias_size[i] + sums[OF_SIZE_OF_MIDDLE * each + i]) * outward;
        finite &= (fabs(constant) + span + fabs(middle) + reach) <= DBL_MAX;
    }
    return finite;
}

/* The six sums of an affine node, see Sums: out[k] (padded size) += sum over active j of matrix_k[j] given[k, j]. */
EVERY_PROCESSOR
void six_sums(double *out, integer stride, const double *w, const double *a, const double *m, const double *given,
              integer columns, const integer *active, integer count) {
    for (integer i = 0; i < stride; i += 8) {
        eight constant = {0}, size = {0}, rest = {0}, middle = {0}, reach = {0}, of_middle = {0};
        for (integer k = 0; k < count; k++) {
            const integer j = active[k];
            const eight weight = *(const eight *)(w + j * stride + i);
            const eight absolute = *(const eight *)(a + j * stride + i);
            const eight merged = *(const eight *)(m + j * stride + i);
            constant += weight * given[j], middle += weight * given[3 * columns + j];
            rest += absolute * given[2 * columns + j], reach += absolute * given[4 * columns + j];
            size += merged * given[columns + j], of_middle += merged * given[5 * columns + j];
        }
        *(eight *)(out + i) += constant, *(eight *)(out + stride + i) += size;
        *(eight *)(out + 2 * stride + i) += rest, *(eight *)(out + 3 * stride + i) += middle;
        *(eight *)(out + 4 * stride + i) += reach, *(eight *)(out + 5 * stride + i) += of_middle;
    }
}

/* out (padded size) += sum over j of matrix[j] x[j]; many x are 0. */
EVERY_PROCESSOR
void add_product(double *out, integer stride, const double *matrix, const double *x, integer columns) {
    integer i = 0;
    for (; i + 32 <= stride; i += 32) {
        eight *o = (eight *)(out + i);
        eight a = o[0], b = o[1], c = o[2], d = o[3];
        for (integer j = 0; j < columns; j++) {
            if (x[j] == 0.0) continue;
            const eight *row = (const eight *)(matrix + j * stride + i);
            a += row[0] * x[j], b += row[1] * x[j], c += row[2] * x[j], d += row[3] * x[j];
        }
        o[0] = a, o[1] = b, o[2] = c, o[3] = d;
    }
    for (; i < stride; i += 8) {
        eight sum = *(const eight *)(out + i);
        for (integer j = 0; j < columns; j++)
            if (x[j] != 0.0) sum += *(const eight *)(matrix + j * stride + i) * x[j];
        *(eight *)(out + i) = sum;
    }
}

/* out (padded size) += sum over active j of matrix[j] x[j]. */
EVERY_PROCESSOR
void add_rows(double *out, integer stride, const double *matrix, const double *x, const integer *active, integer count) {
    integer i = 0;
    for (; i + 32 <= stride; i += 32) {
        eight *o = (eight *)(out + i);
        eight a = o[0], b = o[1], c = o[2], d = o[3];
        for (integer k = 0; k < count; k++) {
            const integer j = active[k];
            const eight *row = (const eight *)(matrix + j * stride + i);
            a += row[0] * x[j], b += row[1] * x[j], c += row[2] * x[j], d += row[3] * x[j];
        }
        o[0] = a, o[1] = b, o[2] = c, o[3] = d;
    }
    for (; i < stride; i += 8) {
        eight sum = *(const eight *)(out + i);
        for (integer k = 0; k < count; k++) sum += *(const eight *)(matrix + active[k] * stride + i) * x[active[k]];
        *(eight *)(out + i) = sum;
    }
}

/* out[k] += row[neuron[k]] radius[k]: symbols that move one neuron each, behind one row of a matrix. */
EVERY_PROCESSOR
void add_fanned(double *out, const double *row, const integer *neuron, const double *radius, integer count) {
    for (integer k = 0; k < count; k++) out[k] += row[neuron[k]] * radius[k];
}

EVERY_PROCESSOR
void scaled_row(double *out, const double *in, double factor, integer count) {
    for (integer k = 0; k < count; k++) out[k] = in[k] * factor;
}

EVERY_PROCESSOR
void add_scaled(double *out, const double *in, double factor, integer count) {
    for (integer k = 0; k < count; k++) out[k] += in[k] * factor;
}

EVERY_PROCESSOR
double absolute_sum(const double *row, integer count) {
    double lanes[8] = {0}, sum = 0.0;
    integer k = 0;
    for (; k + 8 <= count; k += 8)
        for (integer l = 0; l < 8; l++) lanes[l] += fabs(row[k + l]);
    for (; k < count; k++) sum += fabs(row[k]);
    for (integer l = 0; l < 8; l++) sum += lanes[l];
    return sum;
}

EVERY_PROCESSOR
Weighed weigh(const double *row, const double *values, const double *sizes, integer count) {
    double sums[8] = {0}, all[8] = {0};
    Weighed found = {0.0, 0.0};
    integer k = 0;
    for (; k + 8 <= count; k += 8)
        for (integer l = 0; l < 8; l++)
            sums[l] += row[k + l] * values[k + l], all[l] += fabs(row[k + l]) * sizes[k + l];
    for (; k < count; k++) found.sum += row[k] * values[k], found.size += fabs(row[k]) * sizes[k];
    for (integer l = 0; l < 8; l++) found.sum += sums[l], found.size += all[l];
    return found;
}

EVERY_PROCESSOR
Weighed weigh_by_sign(double *restrict out, const double *restrict row, const double *const above[3],
                      const double *const below[3], integer count) {
    const double *restrict slope_above = above[0], *restrict shift_above = above[1], *restrict size_above = above[2];
    const double *restrict slope_below = below[0], *restrict shift_below = below[1], *restrict size_below = below[2];
    double sums[8] = {0}, all[8] = {0};
    Weighed found = {0.0, 0.0};
    integer k = 0;
    for (; k + 8 <= count; k += 8)
        for (integer l = 0; l < 8; l++) {
            const double up = most(row[k + l], 0.0), down = row[k + l] - up; /* no number stays none */
            out[k + l] += up * slope_above[k + l] + down * slope_below[k + l];
            sums[l] += up * shift_above[k + l] + down * shift_below[k + l];
            all[l] += up * size_above[k + l] - down * size_below[k + l];
        }
    for (; k < count; k++) {
        const double up = most(row[k], 0.0), down = row[k] - up;
        out[k] += up * slope_above[k] + down * slope_below[k];
        found.sum += up * shift_above[k] + down * shift_below[k];
        found.size += up * size_above[k] - down * size_below[k];
    }
    for (integer l = 0; l < 8; l++) found.sum += sums[l], found.size += all[l];
    return found;
}
