// The linear recursion x⁺ = A x + f.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <vector>

namespace gainroom {

// The nonzero entries of a square matrix, row by row.
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

    // Adds value · row j to `sum`.
    void add(std::size_t j, double value, double* sum) const {
        for (std::size_t entry = ends_[j]; entry < ends_[j + 1]; entry++) sum[entries_[entry].column] += entries_[entry].value * value;
    }

   private:
    struct Entry {
        std::size_t column;
        double value;
    };
    std::vector<Entry> entries_;
    std::vector<std::size_t> ends_;
};

// Fills states (k + 1, m) from states[0] by x⁺ = A x + f, with A `transposed` (m, m) and forcing f (k, m).
//
// The number of steps made: k, or fewer where the next state is beyond `limit` or no number (that one is not counted).
inline std::size_t recur(const double* transposed, std::size_t size, const double* forcing, std::size_t steps, double* states, double limit) {
    // A matrix with fewer nonzero entries than one in so many is gone through entry by entry: a delay of many ticks is a line of ones.
    constexpr std::size_t kSparse = 4;
    const SparseRows rows(transposed, size);
    const bool sparse = kSparse * rows.count() < size * size;
    for (std::size_t k = 0; k < steps; k++) {
        const double* now = states + k * size;
        double* next = states + (k + 1) * size;
        std::copy(forcing + k * size, forcing + (k + 1) * size, next);
        for (std::size_t j = 0; j < size; j++) {
            if (sparse) {
                rows.add(j, now[j], next);
            } else {  // columns outside: the inner loop is a vector instruction
                for (std::size_t i = 0; i < size; i++) next[i] += transposed[j * size + i] * now[j];
            }
        }
        for (std::size_t i = 0; i < size; i++)
            if (!(std::fabs(next[i]) < limit)) return k;
    }
    return steps;
}

}  // namespace gainroom
