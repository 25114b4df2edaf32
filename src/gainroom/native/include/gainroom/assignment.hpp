// Rows to columns at the least total cost: shortest augmenting paths with prices (Kuhn 1955; Jonker and Volgenant 1987).
#pragma once

#include <cstddef>
#include <limits>
#include <vector>

namespace gainroom {

// cost (n, n), finite → the column of each row (n).
inline std::vector<std::size_t> assigned(const double* cost, std::size_t n) {
    const double infinite = std::numeric_limits<double>::infinity();
    std::vector<double> row_price(n, 0.0), column_price(n + 1, 0.0), nearest(n + 1);
    std::vector<std::size_t> row_of(n + 1, n), before(n + 1);  // column n stands for the row that is placed next
    std::vector<char> reached(n + 1);
    std::vector<std::size_t> left;  // rows whose cheapest column is another's already
    for (std::size_t row = 0; row < n; row++) {
        std::size_t cheapest = 0;
        for (std::size_t j = 1; j < n; j++)
            if (cost[row * n + j] < cost[row * n + cheapest]) cheapest = j;
        row_price[row] = cost[row * n + cheapest];
        if (row_of[cheapest] == n)
            row_of[cheapest] = row;
        else
            left.push_back(row);
    }
    for (const std::size_t placed : left) {
        nearest.assign(n + 1, infinite);
        reached.assign(n + 1, 0);
        row_of[n] = placed;
        std::size_t column = n;
        while (row_of[column] != n) {
            reached[column] = 1;
            const std::size_t row = row_of[column];
            std::size_t next = n;
            double step = infinite;
            for (std::size_t j = 0; j < n; j++) {
                if (reached[j]) continue;
                const double reduced = cost[row * n + j] - row_price[row] - column_price[j];
                if (reduced < nearest[j]) {
                    nearest[j] = reduced;
                    before[j] = column;
                }
                if (nearest[j] < step || next == n) {
                    step = nearest[j];
                    next = j;
                }
            }
            for (std::size_t j = 0; j <= n; j++) {
                if (reached[j]) {
                    row_price[row_of[j]] += step;
                    column_price[j] -= step;
                } else {
                    nearest[j] -= step;
                }
            }
            column = next;
        }
        while (column != n) {
            row_of[column] = row_of[before[column]];
            column = before[column];
        }
    }
    std::vector<std::size_t> column_of(n);
    for (std::size_t j = 0; j < n; j++) column_of[row_of[j]] = j;
    return column_of;
}

}  // namespace gainroom
