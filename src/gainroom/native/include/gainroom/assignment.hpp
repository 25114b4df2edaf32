// Rows to columns at the least total cost: shortest augmenting paths with prices (Kuhn 1955; Jonker and Volgenant 1987).
#pragma once

#include <algorithm>
#include <cstddef>
#include <limits>
#include <numeric>
#include <utility>
#include <vector>

namespace gainroom {

// cost (n, n), finite → the column of each row (n).
inline std::vector<std::size_t> assigned(const double* cost, std::size_t n) {
    const double infinite = std::numeric_limits<double>::infinity();
    std::vector<double> row_price(n, 0.0), column_price(n + 1, 0.0), distance(n + 1);
    std::vector<std::size_t> row_of(n + 1, n), before(n + 1), columns(n);  // column n stands for the row that is placed next
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
        std::fill(distance.begin(), distance.end(), infinite);
        std::iota(columns.begin(), columns.end(), std::size_t{0});
        row_of[n] = placed;
        std::size_t column = n, reached = 0;  // the first of `columns`, each as far from the row that is placed as it can be
        distance[n] = 0.0;
        while (row_of[column] != n) {
            const std::size_t row = row_of[column];
            const double* own = cost + row * n;
            const double so_far = distance[column] - row_price[row];
            std::size_t next = reached;
            double nearest = infinite;
            for (std::size_t k = reached; k < n; k++) {
                const std::size_t j = columns[k];
                const double through = so_far + own[j] - column_price[j];
                if (through < distance[j]) {
                    distance[j] = through;
                    before[j] = column;
                }
                if (distance[j] < nearest) {
                    nearest = distance[j];
                    next = k;
                }
            }
            std::swap(columns[reached], columns[next]);
            column = columns[reached++];
        }
        for (std::size_t k = 0; k < reached; k++) {  // what was reached before the end
            const std::size_t j = k == 0 ? n : columns[k - 1];
            row_price[row_of[j]] += distance[column] - distance[j];
            column_price[j] -= distance[column] - distance[j];
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
