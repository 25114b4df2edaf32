// What n joints feel of the links that they move, in one posture on rigid contacts: W = S (A⁻¹ − A⁻¹Jᵀ(J A⁻¹Jᵀ)⁺J A⁻¹) Sᵀ.
//
// A (N, N) is the mass matrix of all velocities, of which the joints are the last n, and J (c, N) holds the contact directions, of any
// rank. With A = RᵀR, Y = R⁻ᵀSᵀ and Q an orthonormal basis of the columns of R⁻ᵀJᵀ, W = YᵀY − (QᵀY)ᵀ(QᵀY). R is lower triangular, so
// that limbs are eliminated before the base: their rows stay as sparse as the tree is (Featherstone 2005), and zeros are passed over.
// Inner loops run along rows.
#pragma once

#include <cmath>
#include <cstddef>

#include "block.hpp"
#include "complex.hpp"
#include "four.hpp"

namespace gainroom {

// A held direction that is not another's combination moves the links by more than this, relative to the one that moves them most.
constexpr double kRedundant = 1e-9;

// Space for machines of up to `velocities` N, of which `joints` n, and `rows` c held directions. For one thread at a time.
class LinkInertia {
public:
    LinkInertia(std::size_t velocities, std::size_t joints, std::size_t rows)
        : velocities_(velocities), joints_(joints), most_(rows), stride_(fours(velocities)), across_(fours(joints)),
          root_(velocities * stride_), pivots_(velocities), reach_(velocities * across_), held_(rows * stride_), shares_(rows),
          taken_(rows * across_), free_(joints * joints) {}

    std::size_t velocities() const { return velocities_; }
    std::size_t joints() const { return joints_; }
    std::size_t most_rows() const { return most_; }

    // Fills `inverse` W (n, n) from the upper triangle of `mass` (N, N) and `rows` (count, N), row by row. False, and W is not to be
    // used, where the mass matrix is not positive definite or a number is not finite.
    GAINROOM_WIDE bool compute(const double* mass, const double* rows, std::size_t count, double* inverse) {
        const std::size_t size = velocities_, base = size - joints_;
        known_ = count <= most_ && factor(mass);
        if (!known_) return false;
        for (double& entry : reach_) entry = 0.0;
        for (std::size_t k = base; k < size; k++) reach_[k * across_ + k - base] = 1.0;
        for (std::size_t k = size; k-- > 0;) {  // row k of Y: joints from k on, 0 before them
            const std::size_t first = k > base ? (k - base) / 4 * 4 : 0;
            double* row = &reach_[k * across_];
            for (std::size_t j = first; j < joints_; j++) row[j] *= pivots_[k];
            for (std::size_t i = 0; i < k; i++)
                if (const double factor = root_[k * stride_ + i]; factor != 0.0)
                    subtract_fours(&reach_[i * across_ + first], factor, row + first, joints_ - first);
        }
        for (double& entry : free_) entry = 0.0;
        add_squares(free_.data(), reach_.data(), size, 1.0);
        return hold(rows, count, inverse);
    }

    // The same for other `rows` and the mass matrix of before.
    GAINROOM_WIDE bool hold(const double* rows, std::size_t count, double* inverse) {
        if (!known_ || count > most_) return false;
        const std::size_t size = velocities_;
        if (!orthonormal(rows, count)) return false;
        for (std::size_t k = 0; k < rank_ * across_; k++) taken_[k] = 0.0;
        for (std::size_t r = 0; r < rank_; r++) add_product(&taken_[r * across_], joints_, &held_[r * stride_], 1, reach_.data(), size, 1.0);
        for (std::size_t k = 0; k < joints_ * joints_; k++) inverse[k] = free_[k];
        add_squares(inverse, taken_.data(), rank_, -1.0);
        for (std::size_t i = 0; i < joints_; i++)
            for (std::size_t j = 0; j < i; j++) inverse[j * joints_ + i] = inverse[i * joints_ + j];
        return std::isfinite(scalar_product(inverse, inverse, joints_ * joints_));
    }

    // How many of the rows are held that are no combination of others.
    std::size_t held() const { return rank_; }

    // Ŷᵀ (n, N), Ŷ = R⁻ᵀSᵀ without the held directions: W = ŶᵀŶ.
    GAINROOM_INLINE void reach(double* rows) const {
        for (std::size_t j = 0; j < joints_; j++)
            for (std::size_t k = 0; k < velocities_; k++) rows[j * velocities_ + k] = reach_[k * across_ + j];
        for (std::size_t r = 0; r < rank_; r++)
            for (std::size_t j = 0; j < joints_; j++) subtract(rows + j * velocities_, taken_[r * across_ + j], &held_[r * stride_], velocities_);
    }

    // R⁻ᵀJᵀ of one row J (N) without the held directions; its size with them.
    GAINROOM_INLINE double carry(const double* row, double* image) const {
        const std::size_t size = velocities_;
        for (std::size_t k = 0; k < size; k++) image[k] = row[k];
        back_substitute<false>(image, 1);
        const double whole = std::sqrt(scalar_product(image, image, size));
        for (std::size_t r = 0; r < rank_; r++) subtract(image, scalar_product(image, &held_[r * stride_], size), &held_[r * stride_], size);
        return whole;
    }

    // R⁻¹ of `image` (N), in place.
    void release(double* image) const {
        for (std::size_t k = 0; k < velocities_; k++)
            image[k] = (image[k] - scalar_product(&root_[k * stride_], image, k)) * pivots_[k];
    }

private:
    // R⁻ᵀ of `count` rows, in place: one after the other each would wait for itself.
    template <bool padded>
    GAINROOM_INLINE void back_substitute(double* rows, std::size_t count) const {
        for (std::size_t k = velocities_; k-- > 0;)
            for (std::size_t r = 0; r < count; r++) {
                double* row = rows + r * stride_;
                row[k] *= pivots_[k];
                if (row[k] == 0.0) continue;
                if (padded) subtract_fours(row, row[k], &root_[k * stride_], k);
                else subtract(row, row[k], &root_[k * stride_], k);
            }
    }

    // R row by row, from the upper triangle; in each row 0 from its diagonal on.
    GAINROOM_WIDE bool factor(const double* mass) {
        const std::size_t size = velocities_;
        for (std::size_t i = 0; i < size; i++)
            for (std::size_t j = i; j < size; j++) root_[j * stride_ + i] = mass[i * size + j];
        for (std::size_t k = size; k-- > 0;) {
            double* row = &root_[k * stride_];
            if (!(row[k] > 1e-15 * mass[k * size + k])) return false;
            const double pivot = pivots_[k] = 1.0 / std::sqrt(row[k]);
            for (std::size_t j = 0; j < k; j++) row[j] *= pivot;
            for (std::size_t j = k; j < stride_; j++) row[j] = 0.0;
            for (std::size_t i = 0; i < k; i++)
                if (row[i] != 0.0) subtract_fours(&root_[i * stride_], row[i], row, i + 1);
        }
        return true;
    }

    // Columns of R⁻ᵀJᵀ as rank_ rows of held_, orthonormal (Gram and Schmidt, twice); false where one has no size that is a number.
    GAINROOM_WIDE bool orthonormal(const double* rows, std::size_t count) {
        const std::size_t size = stride_;
        for (std::size_t r = 0; r < count; r++)
            for (std::size_t k = 0; k < size; k++) held_[r * size + k] = k < velocities_ ? rows[r * velocities_ + k] : 0.0;
        back_substitute<true>(held_.data(), count);
        double largest = 0.0;
        for (std::size_t r = 0; r < count; r++) {
            const double* row = &held_[r * size];
            const double square = scalar_product(row, row, size);
            if (!std::isfinite(square)) return false;
            for (std::size_t k = 0; square == 0.0 && k < size; k++)
                if (row[k] != 0.0) return false;  // its square is none
            largest = std::fmax(largest, std::sqrt(square));
        }
        std::size_t rank = 0;
        for (std::size_t r = 0; r < count; r++) {
            double* row = &held_[rank * size];
            if (rank < r)
                for (std::size_t k = 0; k < size; k++) row[k] = held_[r * size + k];
            double before = std::sqrt(scalar_product(row, row, size)), left = project(row, rank);
            while (left < 0.5 * before && left > kRedundant * largest) {  // what was taken away left its round-off behind
                before = left;
                left = project(row, rank);
            }
            if (!(left > kRedundant * largest)) continue;
            for (std::size_t k = 0; k < size; k++) row[k] /= left;
            rank++;
        }
        rank_ = rank;
        return true;
    }

    // Takes the first `rank` rows of held_ out of `row`; its size then.
    GAINROOM_WIDE double project(double* row, std::size_t rank) {
        const std::size_t size = stride_;
        for (std::size_t m = 0; m < rank; m++) shares_[m] = scalar_product(row, &held_[m * size], size);  // none waits for another
        std::size_t m = 0;
        for (; m + 2 <= rank; m += 2) {
            const double *one = &held_[m * size], *two = one + size, p = shares_[m], q = shares_[m + 1];
            for (std::size_t k = 0; k < size; k++) row[k] -= p * one[k] + q * two[k];
        }
        if (m < rank) subtract(row, shares_[m], &held_[m * size], size);
        return std::sqrt(scalar_product(row, row, size));
    }

    // The lower triangle of `inverse` gets sign · Σ rowᵀ row over `count` rows of joints.
    GAINROOM_INLINE void add_squares(double* inverse, const double* rows, std::size_t count, double sign) const {
        for (std::size_t i = 0; i < joints_; i++) add_product(inverse + i * joints_, i + 1, rows + i, across_, rows, count, sign);
    }

    // `sums`, with those beside them up to whole fours, get sign · Σ_k factor_k row_k over `count` rows of joints; factors lie `apart`.
    GAINROOM_INLINE void add_product(double* sums, std::size_t end, const double* factors, std::size_t apart, const double* rows, std::size_t count,
                     double sign) const {
        std::size_t j = 0;
        for (; j < end && j + 12 <= joints_; j += 12) add_fours<3>(sums + j, factors, apart, rows + j, count, sign);
        for (; j < end && j + 4 <= joints_; j += 4) add_fours<1>(sums + j, factors, apart, rows + j, count, sign);
        for (; j < end; j++)
            for (std::size_t k = 0; k < count; k++) sums[j] += sign * factors[k * apart] * rows[k * across_ + j];
    }

    // Several at once: one alone would wait for its own sum.
    template <std::size_t many>
    GAINROOM_INLINE void add_fours(double* sums, const double* factors, std::size_t apart, const double* rows, std::size_t count, double sign) const {
        Four sum[many];
        for (std::size_t m = 0; m < many; m++) sum[m] = four(sums + 4 * m);
        for (std::size_t k = 0; k < count; k++) {
            const double factor = sign * factors[k * apart];
            for (std::size_t m = 0; m < many; m++) sum[m] += factor * four(rows + k * across_ + 4 * m);
        }
        for (std::size_t m = 0; m < many; m++) put(sums + 4 * m, sum[m]);
    }

    std::size_t velocities_, joints_, most_, stride_, across_;  // of rows of velocities and of joints: whole fours
    Vector<double> root_, pivots_, reach_, held_, shares_, taken_, free_;  // free_: W without contacts, its lower triangle
    std::size_t rank_ = 0;
    bool known_ = false;
};

}  // namespace gainroom
