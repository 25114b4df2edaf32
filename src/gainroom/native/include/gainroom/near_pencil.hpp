// Roots near a crossing in the span of few modes: M + δω D + δg G (k, k), symmetric, with a root j(ω + δω) at the factor g + δg where it is
// singular. δω = 0 is one at δg = 0: the crossing's own. A root is unstable where Im δω < 0.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>
#include <utility>

#include "complex.hpp"

namespace gainroom {

class NearPencil {
public:
    static constexpr std::size_t kMost = 3;
    using Square = Complex[kMost][kMost];

    // A factor below the crossing at which a root is the least stable, and that root.
    struct Peak {
        double by = 0.0;     // δg
        Complex root = 0.0;  // δω
        double below = 0.0, above = 0.0;  // δg on either side, towards which roots are stable again; above 0: not before the crossing
    };

    // False where D is singular. `size` k >= 2; roots farther from the crossing than `radius` do not count, and one that is δω from it is taken
    // for less stable by `bend` |δω|²: what a loop that is not linear in ω may make of it.
    bool set(const Square& m, const Square& d, const Square& g, std::size_t size, double radius, double bend) {
        size_ = size;
        nearest_ = 0.0;
        radius_ = radius;
        deepest_ = std::numeric_limits<double>::infinity();
        bend_ = bend;
        Square inverse{};
        if (!invert(d, inverse)) return false;
        give_ = norm_of(inverse);
        own_ = over(g[0][0], d[0][0]);
        multiply(inverse, m, fixed_);
        multiply(inverse, g, turning_);
        return std::isfinite(norm_of(fixed_) + norm_of(turning_));
    }

    // The distance of the root next to the crossing's own, and how far roots may move per unit of δg.
    double distance() const {
        Complex roots[kMost];
        roots_at(0.0, roots);
        double own = 1e300, next = 1e300;
        for (std::size_t k = 0; k < size_; k++) {
            const double off = std::abs(roots[k]);
            next = std::min(next, std::max(own, off));
            own = std::min(own, off);
        }
        return next;
    }
    // How stable the least stable root is beside those that are known, at the highest factor that is looked at and at peaks below: right after `peak`.
    double margin() const { return std::max(0.0, margin_); }
    double speed() const { return norm_of(turning_); }
    // The same per unit of M.
    double give() const { return give_; }

    // Looks from here on at factors of another crossing's and lower ones, which are at least `nearest` below this one's, and leave out its root
    // at δω = `known`.
    void look_at(double nearest, double known) {
        nearest_ = nearest;
        known_ = known;
    }
    bool is_known(Complex root) const { return nearest_ > 0.0 && std::abs(root - known_) < kSame * std::fabs(known_) + kSame * kSame * radius_; }

    // Where roots are the least stable between δg = −most and −least, apart from the rise towards the crossing itself; false: everywhere −Im δω of
    // all of them is below −slack. Steps are in proportion to the distance from the crossing, as what roots do there is.
    bool peak(double most, double least, double slack, Peak& found) {
        double at[3], height[3];
        for (int k = 0; k < 3; k++) height[k] = growth(-(at[k] = k == 0 ? most : nearer(at[k - 1])));
        double highest = -1e300;
        const Complex beside = nearest_ > 0.0 ? beside_known() : this->beside();
        margin_ = stability(beside);
        if (height[0] > 0.0) consider({-at[0], least_stable(-at[0]), -kStep * at[0], -at[1]}, highest, found);
        while (true) {
            const bool tops = height[1] >= height[0] && height[1] >= height[2] && at[1] > at[2];
            if (tops) margin_ = std::min(margin_, -height[1]);
            const double drop = std::max(height[1] - height[0], height[1] - height[2]);
            if (tops && height[1] > -kSharp * drop - slack) consider(refined(at[0], at[2]), highest, found);
            if (at[2] <= least) break;
            step(at, height);
        }
        if (nearest_ > 0.0 && stability(beside) < slack) consider({-nearest_, beside, -at[1], 0.0}, highest, found);
        else if (nearest_ == 0.0 && height[2] > 0.0) consider({-at[2], least_stable(-at[2]), -at[1], 0.0}, highest, found);
        return highest > -slack;
    }

    // δg between one at which roots are stable and one at which some are not, where that changes.
    double change(double stable, double unstable) const {
        for (int k = 0; k < 30; k++) {
            const double middle = 0.5 * (stable + unstable);
            (growth(middle) > 0.0 ? unstable : stable) = middle;
        }
        return unstable;
    }

    // By how much the least stable root may be unstable, in −Im δω; that root.
    double growth(double by) const { return -stability(least_stable(by)); }
    Complex least_stable(double by) const {
        Complex roots[kMost];
        roots_at(by, roots);
        return least_stable(roots, kMost, false);
    }

    // The least stable root at the crossing, but for its own; how stable a root is at least.
    Complex beside() const {
        Complex roots[kMost];
        roots_at(0.0, roots);
        std::size_t own = 0;
        for (std::size_t k = 1; k < size_; k++)
            if (std::norm(roots[k]) < std::norm(roots[own])) own = k;
        return least_stable(roots, own, true);
    }
    double stability(Complex root) const { return root.imag() - bend_ * std::norm(root); }

    // Only roots that are nearer than `root`, in the radius or unstable by less.
    void narrow(Complex root) {
        if (std::abs(root) < radius_) radius_ = kCloser * std::abs(root);
        else deepest_ = kLessDeep * std::fabs(root.imag());
    }

    // All of them, in no order.
    void roots_at(double by, Complex* roots) const {
        Square a;
        at(by, a);
        const Complex middle = size_ == 2 ? 0.5 * (a[0][0] + a[1][1]) : (a[0][0] + a[1][1] + a[2][2]) / 3.0;
        for (std::size_t k = 0; k < size_; k++) a[k][k] -= middle;
        if (size_ == 2) {
            const Complex apart = std::sqrt(times(a[0][1], a[1][0]) - times(a[0][0], a[1][1]));
            roots[0] = middle + apart;
            roots[1] = middle - apart;
            return;
        }
        // x³ + 3 p x + 2 q without a square: Cardano.
        Complex p = 0.0;
        for (std::size_t i = 0; i < 3; i++)
            for (std::size_t j = 0; j < 3; j++) p -= times(a[i][j], a[j][i]);
        p /= 6.0;
        const Complex q = -0.5 * determinant(a), apart = std::sqrt(times(q, q) + times(p, times(p, p)));
        const Complex cube = std::norm(apart - q) > std::norm(apart + q) ? apart - q : -apart - q;
        if (cube == Complex(0.0)) {
            roots[0] = roots[1] = roots[2] = middle;
            return;
        }
        Complex u = std::polar(std::cbrt(std::abs(cube)), std::arg(cube) / 3.0);
        const Complex third(-0.5, 0.8660254037844386);
        for (std::size_t k = 0; k < 3; k++, u = times(u, third)) roots[k] = middle + u - over(p, u);
    }

    // Combination of the modes at a root: what the rows of M + δω D + δg G have in common.
    void mode(double by, Complex root, Complex* parts) const {
        Square a;
        at(by, a);
        for (std::size_t k = 0; k < size_; k++) a[k][k] -= root;
        if (size_ == 2) {
            const std::size_t row = std::norm(a[0][0]) + std::norm(a[0][1]) > std::norm(a[1][0]) + std::norm(a[1][1]) ? 0 : 1;
            parts[0] = a[row][1];
            parts[1] = -a[row][0];
            return;
        }
        double best = -1.0;
        for (std::size_t i = 0; i < 3; i++) {
            const Complex *p = a[i], *q = a[(i + 1) % 3];
            const Complex cross[3] = {times(p[1], q[2]) - times(p[2], q[1]), times(p[2], q[0]) - times(p[0], q[2]),
                                      times(p[0], q[1]) - times(p[1], q[0])};
            const double size = std::norm(cross[0]) + std::norm(cross[1]) + std::norm(cross[2]);
            if (size <= best) continue;
            best = size;
            std::copy_n(cross, 3, parts);
        }
    }

private:
    static constexpr double kStep = 1.8, kSharp = 1.0;  // a peak between two steps is no higher than so many times what they fall
    static constexpr double kCloser = 0.8, kLessDeep = 0.5;  // what is left of the radius, and of how unstable roots beyond it count
    static constexpr double kSame = 0.3;  // of the distance between two crossings: one's root as the other's span tells it
    static constexpr int kRefined = 9;

    void step(double* at, double* height) const {
        for (int k = 0; k < 2; k++) at[k] = at[k + 1], height[k] = height[k + 1];
        at[2] = nearer(at[2]);
        height[2] = growth(-at[2]);
    }
    double nearer(double at) const { return std::max(at / kStep, nearest_); }

    // The least stable root at the other crossing's factor beside its own and this one's, where that is about as stable there as it leads to expect.
    Complex beside_known() const {
        Complex roots[kMost];
        roots_at(-nearest_, roots);
        const Complex expected = nearest_ * own_;
        std::size_t own = 0;
        for (std::size_t k = 1; k < size_; k++)
            if (std::norm(roots[k] - expected) < std::norm(roots[own] - expected)) own = k;
        Complex least(0.0, radius_);
        for (std::size_t k = 0; k < size_; k++) {
            const bool as_expected = k == own && expected.imag() > 0.0 && roots[k].imag() > 0.5 * expected.imag();
            if (counts(roots[k], true) && !is_known(roots[k]) && !as_expected && stability(roots[k]) < stability(least))
                least = roots[k];
        }
        return least;
    }

    // `all`: one that is unstable by much, too, which may in truth be nearer.
    bool counts(Complex root, bool all) const {
        return std::norm(root) < radius_ * radius_ || (all && root.imag() < 0.0 && -root.imag() < deepest_ && std::fabs(root.real()) < radius_);
    }

    // Of `roots` but one; j radius where none counts.
    Complex least_stable(const Complex* roots, std::size_t left_out, bool all) const {
        Complex least(0.0, radius_);
        double lowest = radius_;
        for (std::size_t k = 0; k < size_; k++)
            if (k != left_out && counts(roots[k], all) && stability(roots[k]) < lowest) {
                least = roots[k];
                lowest = stability(least);
            }
        return least;
    }

    void consider(const Peak& one, double& highest, Peak& found) const {
        if (!(-stability(one.root) > highest)) return;
        highest = -stability(one.root);
        found = one;
    }

    // The peak between two distances by golden sections.
    Peak refined(double far, double near) const {
        constexpr double kGolden = 0.6180339887498949;
        double a = far, b = near, c = b + kGolden * (a - b), d = a + kGolden * (b - a), at_c = growth(-c), at_d = growth(-d);
        for (int k = 0; k < kRefined; k++) {
            if (at_c > at_d) {
                b = d;
                d = c, at_d = at_c;
                c = b + kGolden * (a - b), at_c = growth(-c);
            } else {
                a = c;
                c = d, at_c = at_d;
                d = a + kGolden * (b - a), at_d = growth(-d);
            }
        }
        const double best = at_c > at_d ? c : d;
        return {-best, least_stable(-best), -far, -near};
    }

    // −D⁻¹(M + δg G), whose eigenvalues are δω.
    void at(double by, Square& a) const {
        for (std::size_t i = 0; i < size_; i++)
            for (std::size_t j = 0; j < size_; j++) a[i][j] = -(fixed_[i][j] + by * turning_[i][j]);
    }

    static Complex determinant(const Square& a) {
        return times(a[0][0], times(a[1][1], a[2][2]) - times(a[1][2], a[2][1])) - times(a[0][1], times(a[1][0], a[2][2]) - times(a[1][2], a[2][0])) +
               times(a[0][2], times(a[1][0], a[2][1]) - times(a[1][1], a[2][0]));
    }

    bool invert(const Square& a, Square& inverse) const {
        if (size_ == 2) {
            const Complex whole = times(a[0][0], a[1][1]) - times(a[0][1], a[1][0]);
            inverse[0][0] = over(a[1][1], whole), inverse[0][1] = over(-a[0][1], whole);
            inverse[1][0] = over(-a[1][0], whole), inverse[1][1] = over(a[0][0], whole);
            return std::norm(whole) > 0.0 && std::isfinite(std::norm(whole));
        }
        const Complex whole = determinant(a);
        for (std::size_t i = 0; i < 3; i++)
            for (std::size_t j = 0; j < 3; j++) {
                const std::size_t r = (j + 1) % 3, s = (j + 2) % 3, c = (i + 1) % 3, e = (i + 2) % 3;
                inverse[i][j] = over(times(a[r][c], a[s][e]) - times(a[r][e], a[s][c]), whole);
            }
        return std::norm(whole) > 0.0 && std::isfinite(std::norm(whole));
    }

    void multiply(const Square& a, const Square& b, Square& product) const {
        for (std::size_t i = 0; i < size_; i++)
            for (std::size_t j = 0; j < size_; j++) {
                product[i][j] = 0.0;
                for (std::size_t k = 0; k < size_; k++) product[i][j] += times(a[i][k], b[k][j]);
            }
    }

    double norm_of(const Square& a) const {
        double sum = 0.0;
        for (std::size_t i = 0; i < size_; i++)
            for (std::size_t j = 0; j < size_; j++) sum += std::norm(a[i][j]);
        return std::sqrt(sum);
    }

    std::size_t size_ = 0;
    double radius_ = 0.0, deepest_ = 0.0, bend_ = 0.0, margin_ = 0.0, give_ = 0.0, nearest_ = 0.0, known_ = 0.0;
    Complex own_ = 0.0;           // −dω/dg of the crossing's own root
    Square fixed_{}, turning_{};  // D⁻¹M, D⁻¹G
};

}  // namespace gainroom
