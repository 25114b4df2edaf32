// Compliance of links on joints, C = R (s² I + G + Hᵀ Y H)⁻¹ Rᵀ, at four frequencies at once: one complex symmetric matrix in each place of Four.
#pragma once

#include <algorithm>
#include <cstddef>
#include <vector>

#include "complex.hpp"
#include "four.hpp"
#include "four_factors.hpp"

namespace gainroom {

class LinkCompliance {
public:
    // H (springs, r), whose first `joints` rows are R; G (r, r), symmetric.
    LinkCompliance(const double* h, const double* g, std::size_t springs, std::size_t joints, std::size_t r)
        : springs_(springs), joints_(joints), r_(r), root_(h, h + joints * r), inner_(g, g + r * r), upper_(kEntry * r * r), moved_(kEntry * r * joints),
          inverse_(kEntry * r), stiffness_(kEntry * springs) {
        pairs_.reserve(springs * r * (r + 1) / 2);
        for (std::size_t i = 0; i < r; i++)
            for (std::size_t j = i; j < r; j++)
                for (std::size_t k = 0; k < springs; k++) pairs_.push_back(h[k * r + i] * h[k * r + j]);
    }

    // The diagonal of C (count, joints), or `whole` C (count, joints, joints), at s = jω with Y (count, springs).
    GAINROOM_WIDE void at(const double* omega, const Complex* y, std::size_t count, bool whole, Complex* found) {
        const std::size_t each = whole ? joints_ * joints_ : joints_;
        for (std::size_t first = 0; first < count; first += kLanes) {
            const std::size_t lanes = std::min(kLanes, count - first);
            double squares[kLanes];
            for (std::size_t lane = 0; lane < kLanes; lane++) {
                const std::size_t k = first + std::min(lane, lanes - 1);
                squares[lane] = omega[k] * omega[k];
                for (std::size_t j = 0; j < springs_; j++) put(&stiffness_[kEntry * j], lane, y[k * springs_ + j]);
            }
            assemble(four(squares));
            factor();
            for (std::size_t i = 0; i < joints_; i++)
                for (std::size_t j = whole ? 0 : i; j <= i; j++) {
                    const double nothing[kLanes] = {};
                    FourComplex sum{four(nothing), four(nothing)};
                    for (std::size_t k = 0; k < r_; k++) {
                        const double* row = &moved_[kEntry * k * joints_];
                        sum = sum + entry(row + kEntry * i) * entry(row + kEntry * j) * entry(&inverse_[kEntry * k]);
                    }
                    double values[kEntry];
                    put(values, sum);
                    for (std::size_t lane = 0; lane < lanes; lane++) {
                        const Complex value{values[lane], values[kLanes + lane]};
                        Complex* at = found + (first + lane) * each;
                        if (whole) at[i * joints_ + j] = at[j * joints_ + i] = value;
                        else at[i] = value;
                    }
                }
        }
    }

private:
    // Upper triangle of −ω² I + G + Hᵀ Y H, by rows of r.
    GAINROOM_WIDE void assemble(const Four& squares) {
        const double* pair = pairs_.data();
        const double nothing[kLanes] = {};
        for (std::size_t i = 0; i < r_; i++)
            for (std::size_t j = i; j < r_; j++, pair += springs_) {
                Four re = four(nothing) + inner_[i * r_ + j], im = four(nothing);
                if (i == j) re = re - squares;
                for (std::size_t k = 0; k < springs_; k++) {
                    re = re + pair[k] * four(&stiffness_[kEntry * k]);
                    im = im + pair[k] * four(&stiffness_[kEntry * k + kLanes]);
                }
                put(&upper_[kEntry * (i * r_ + j)], FourComplex{re, im});
            }
    }

    // L D Lᵀ of it, and L⁻¹ Rᵀ in its stead: without exchanges, as damping keeps pivots from 0.
    GAINROOM_WIDE void factor() {
        const double nothing[kLanes] = {};
        const Four zero = four(nothing);
        for (std::size_t k = 0; k < r_; k++)
            for (std::size_t j = 0; j < joints_; j++) put(&moved_[kEntry * (k * joints_ + j)], FourComplex{zero + root_[j * r_ + k], zero});
        for (std::size_t k = 0; k < r_; k++) {
            const double *row = &upper_[kEntry * k * r_], *known = &moved_[kEntry * k * joints_];
            const FourComplex inverse = inverse_of(entry(row + kEntry * k));
            put(&inverse_[kEntry * k], inverse);
            for (std::size_t i = k + 1; i < r_; i++) {
                const FourComplex factor = entry(row + kEntry * i) * inverse;
                double* to = &upper_[kEntry * i * r_];
                for (std::size_t j = i; j < r_; j++) put(to + kEntry * j, entry(to + kEntry * j) - factor * entry(row + kEntry * j));
                double* moved = &moved_[kEntry * i * joints_];
                for (std::size_t j = 0; j < joints_; j++) put(moved + kEntry * j, entry(moved + kEntry * j) - factor * entry(known + kEntry * j));
            }
        }
    }

    std::size_t springs_, joints_, r_;
    std::vector<double> root_, inner_, pairs_;  // pairs_: H_ki H_kj by i ≤ j, then k
    Numbers upper_, moved_, inverse_, stiffness_;
};

}  // namespace gainroom
