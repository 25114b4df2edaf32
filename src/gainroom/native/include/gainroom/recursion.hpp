// The linear recursion x⁺ = A x + f.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <vector>

namespace gainroom {

// A square matrix, row by row, by the nonzero entries: a delay of many ticks is a line of ones.
class SparseRows {
   public:
    SparseRows(const double* matrix, std::size_t size) {
        ends_.reserve(size + 1);
        ends_.push_back(0);
        for (std::size_t j = 0; j < size; j++) {
            for (std::size_t i = 0; i < size; i++)
                if (matrix[j * size + i] != 0.0) entries_.push_back({i, matrix[j * size + i]});
            ends_.push_back(entries_.size());
        }
    }

    std::size_t count() const { return entries_.size(); }

    // Adds Σ_j factors[j] · row j to `sum`, which is another array.
    void add(const double* factors, double* sum) const {
        const Entry* entry = entries_.data();
        for (std::size_t j = 0; j + 1 < ends_.size(); j++) {
            const double factor = factors[j];
            for (const Entry* end = entries_.data() + ends_[j + 1]; entry < end; entry++) sum[entry->column] += entry->value * factor;
        }
    }

   private:
    struct Entry {
        std::size_t column;
        double value;
    };
    std::vector<Entry> entries_;
    std::vector<std::size_t> ends_;
};

// A square matrix, row by row.
struct DenseRows {
    const double* matrix;
    std::size_t size;

    // As SparseRows::add, and in the same order. Four rows at a time, as each sum is then fetched and put back a quarter as often.
    void add(const double* factors, double* sum) const {
        std::size_t j = 0;
        for (; j + 4 <= size; j += 4) {
            const double *a = matrix + j * size, *b = a + size, *c = b + size, *d = c + size;
            const double fa = factors[j], fb = factors[j + 1], fc = factors[j + 2], fd = factors[j + 3];
            for (std::size_t i = 0; i < size; i++) sum[i] = (((sum[i] + a[i] * fa) + b[i] * fb) + c[i] * fc) + d[i] * fd;
        }
        for (; j < size; j++)
            for (std::size_t i = 0; i < size; i++) sum[i] += matrix[j * size + i] * factors[j];
    }
};

// `force(k, sum)` writes what drives step k.
template <typename Rows, typename Force>
std::size_t recur_by(const Rows& rows, std::size_t size, const Force& force, std::size_t steps, double* states, double limit) {
    for (std::size_t k = 0; k < steps; k++) {
        double* next = states + (k + 1) * size;
        force(k, next);
        rows.add(states + k * size, next);
        for (std::size_t i = 0; i < size; i++)
            if (!(std::fabs(next[i]) < limit)) return k;
    }
    return steps;
}

template <typename Force>
std::size_t recur_driven(const double* transposed, std::size_t size, const Force& force, std::size_t steps, double* states, double limit) {
    constexpr std::size_t kSparse = 6;  // where fewer than one entry in so many is not zero, going through them one by one is faster
    const SparseRows sparse(transposed, size);
    if (kSparse * sparse.count() < size * size) return recur_by(sparse, size, force, steps, states, limit);
    return recur_by(DenseRows{transposed, size}, size, force, steps, states, limit);
}

// Fills states (k + 1, m) from states[0] by x⁺ = A x + f, with A `transposed` (m, m) and forcing f (k, m).
//
// The number of steps made: k, or fewer where the next state is beyond `limit` or no number (that one is not counted).
inline std::size_t recur(const double* transposed, std::size_t size, const double* forcing, std::size_t steps, double* states,
                         double limit) {
    const auto copied = [=](std::size_t k, double* next) { std::copy(forcing + k * size, forcing + (k + 1) * size, next); };
    return recur_driven(transposed, size, copied, steps, states, limit);
}

// Outputs y = C x that come back late: u_j is y_j of `whole`[j] >= 1 steps ago, and of one more by the share `part`[j]; 0 before the start.
struct LateOutputs {
    std::size_t count;
    const double *rows, *before, *after;  // of C, and what u at the beginning and at the end of a step adds to its end (count, m)
    const std::int64_t* whole;
    const double* part;
    double* sent;  // (k + 1, count): y

    double arriving(std::size_t k, std::size_t j) const {
        const auto late = static_cast<std::size_t>(whole[j]);
        const auto at = [this, k, j](std::size_t ago) { return k < ago ? 0.0 : sent[(k - ago) * count + j]; };
        return (1 - part[j]) * at(late) + part[j] * at(late + 1);
    }
};

// The recursion with delayed feedback: its forcing less the response to the late outputs of its own states.
inline std::size_t recur_late(const double* transposed, std::size_t size, const double* forcing, const LateOutputs& late, std::size_t steps,
                              double* states) {
    const auto driven = [&](std::size_t k, double* next) {
        const double* now = states + k * size;
        for (std::size_t j = 0; j < late.count; j++) {
            double sum = 0.0;
            for (std::size_t i = 0; i < size; i++) sum += late.rows[j * size + i] * now[i];
            late.sent[k * late.count + j] = sum;
        }
        std::copy(forcing + k * size, forcing + (k + 1) * size, next);
        for (std::size_t j = 0; j < late.count; j++) {
            const double first = late.arriving(k, j), then = late.arriving(k + 1, j);
            for (std::size_t i = 0; i < size; i++) next[i] -= late.before[j * size + i] * first + late.after[j * size + i] * then;
        }
    };
    return recur_driven(transposed, size, driven, steps, states, std::numeric_limits<double>::infinity());
}

}  // namespace gainroom
