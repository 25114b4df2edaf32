#include "gainroom/loop_curves.hpp"

#include "arrays.hpp"

using gainroom::Complex;
using gainroom::DirectedGains;
using gainroom::DirectedLoop;
using ComplexVector = Array<const Complex, 1>;

template <typename T>
static std::vector<double> listed(const T& array) {
    return {array.data(), array.data() + array.size()};
}

static DirectedGains gains_of(const DirectedLoop& loop, const Matrix& gains) {
    require(has_shape(gains, 3, loop.directions), "gains must be (3, m)");
    const double* first = gains.data();
    const std::size_t m = loop.directions;
    return {{first, first + m}, {first + m, first + 2 * m}, {first + 2 * m, first + 3 * m}};
}

static void set_plant(DirectedLoop& loop, Matrix mobility, Matrix joints, Matrix root, Matrix gravity, Matrix hung, Matrix contacts,
                      Matrix drives, bool motor_side) {
    gainroom::Actuated& to = loop.actuated;
    const std::size_t n = to.size, c = contacts.shape(1);
    require(has_shape(mobility, n, n) && has_shape(joints, 5, n) && root.shape(0) == n && has_shape(drives, 3, n) && contacts.shape(0) == 2,
            "a plant's arrays do not fit");
    require(gravity.size() == 0 || has_shape(gravity, n, n), "gravity must be (n, n)");
    require(has_shape(hung, c, root.shape(1)), "a plant's contacts do not fit");
    const auto row = [n](const Matrix& from, std::size_t k) { return std::vector<double>(from.data() + k * n, from.data() + (k + 1) * n); };
    to.step = 0.0;
    to.motor_side = motor_side;
    to.mobility = listed(mobility);
    to.motor_inertia = row(joints, 0);
    to.stiffness = row(joints, 1);
    to.damping = row(joints, 2);
    to.motor_viscous = row(joints, 3);
    to.link_viscous = row(joints, 4);
    to.root = listed(root);
    to.gravity = listed(gravity);
    to.loaded = gravity.size() > 0;
    for (double value : to.link_viscous) to.loaded |= value != 0;
    to.hung = listed(hung);
    to.contact_stiffness.assign(contacts.data(), contacts.data() + c);
    to.contact_damping.assign(contacts.data() + c, contacts.data() + 2 * c);
    to.bandwidth = row(drives, 0);
    to.damping_ratio = row(drives, 1);
    to.delay = row(drives, 2);
}

static gainroom::StateForm state_form(const Matrix& a, const Matrix& b, const Matrix& c, std::size_t n) {
    const std::size_t order = a.shape(0);
    require(has_shape(a, order, order) && has_shape(b, order, n) && has_shape(c, n, order), "a sampled plant's arrays do not fit");
    return {listed(a), listed(b), listed(c)};
}

static void set_held(DirectedLoop& loop, Matrix a, Matrix b, Matrix c, Matrix hessenberg, Matrix turned_b, Matrix turned_c, double fast,
                     Vector delay, double step) {
    gainroom::Actuated& to = loop.actuated;
    require(step > 0 && delay.size() == to.size, "a sampled plant needs a step > 0 and the delay of every joint");
    to.step = step;
    to.whole = state_form(a, b, c, to.size);
    to.hessenberg = state_form(hessenberg, turned_b, turned_c, to.size);
    to.fast = fast;
    to.delay = listed(delay);
    loop.last = gainroom::kPi / step;
}

static void set_modes(DirectedLoop& loop, const gainroom::ModalLoop& modes) {
    require(modes.size == loop.actuated.size && modes.step == loop.actuated.step, "the modes are those of another loop");
    loop.actuated.modes = std::make_unique<gainroom::ModalResponse>(modes);
}

static void set_law(DirectedLoop& loop, Vector velocity_above, Vector velocity_below, Vector integral_above, Vector integral_below,
                    ComplexVector zeros, ComplexVector poles, double gain) {
    loop.velocity = {listed(velocity_above), listed(velocity_below)};
    loop.integrator = {listed(integral_above), listed(integral_below)};
    loop.shaping = {{zeros.data(), zeros.data() + zeros.size()}, {poles.data(), poles.data() + poles.size()}, gain};
}

static void set_matrix(DirectedLoop& loop, Matrix gain, bool velocity, bool integral, double slow) {
    require(has_shape(gain, loop.size(), loop.directions) && !loop.joints(), "a gain matrix (n, m) of directions is needed");
    loop.matrices.push_back({velocity, integral, listed(gain)});
    loop.slow = slow;
}

static void set_boundary(DirectedLoop& loop, Vector grid, Vector leaning, double tilt, double lean, std::int64_t unstable_poles, double settles) {
    require(grid.size() > 1, "two frequencies at least are needed");
    loop.grid = listed(grid);
    loop.leaning = listed(leaning);
    loop.tilt = tilt;
    loop.lean = lean;
    loop.unstable_poles = static_cast<int>(unstable_poles);
    loop.settles = settles;
}

class Look {
public:
    Look(DirectedLoop& loop, Matrix gains, double factor, double phase, double peak, bool between, bool smooth) : loop_(loop) {
        require(!loop.grid.empty() && loop.actuated.size > 0, "the plant and the first samples are needed");
        require(factor > 1 && phase > 0 && !std::isnan(peak), "a factor > 1, a phase > 0 and a peak are needed");
        const DirectedGains own = gains_of(loop, gains);
        nb::gil_scoped_release release;
        samples_ = std::make_unique<gainroom::LoopSamples>(loop, own, factor, phase, peak, between, smooth);
    }

    bool followed() const { return samples_->ok(); }
    bool singular() const { return samples_->state() == gainroom::LookState::singular; }
    std::int64_t unstable() const { return samples_->unstable(); }
    std::size_t samples() const { return samples_->samples().size(); }

    void tell_apart(double factor, double phase) {
        nb::gil_scoped_release release;
        samples_->tell_apart(std::log(factor), phase);
    }

    nb::tuple least(bool apart) {
        gainroom::LeastMargins found;
        {
            nb::gil_scoped_release release;
            found = gainroom::LoopCurves(*samples_).least(apart);
        }
        return nb::make_tuple(found.factor, found.one_factor, found.phase, found.one_phase, found.peak, found.peak_omega);
    }

    nb::tuple peak(double slope, double offset) {
        const gainroom::MovingMargin found = gainroom::SensitivityPeaks(*samples_).highest(slope, offset);
        return nb::make_tuple(found.margin, found.omega);
    }

    // (n, 4): |ln g| up and down, a phase, the largest |S_ii|.
    nb::object one_loop() {
        std::vector<double> found;
        {
            nb::gil_scoped_release release;
            const std::vector<gainroom::OneLoopMargins> margins = gainroom::LoopCurves(*samples_).one_loop();
            const std::vector<gainroom::MovingMargin> peaks = gainroom::SensitivityPeaks(*samples_).highest_of_each(1.0, 0.0);
            for (std::size_t i = 0; i < margins.size(); i++)
                found.insert(found.end(), {margins[i].up, margins[i].down, margins[i].phase, peaks[i].margin});
        }
        return owned(found.data(), loop_.loops(), 4);
    }

    nb::object one_loop_crossings(std::size_t which) {
        require(which < loop_.loops(), "there is no such loop");
        std::vector<double> found;
        {
            nb::gil_scoped_release release;
            found = gainroom::LoopCurves(*samples_).one_loop_crossings(which);
        }
        return owned(found.data(), found.size(), 1);
    }

    // (2, 2): above 1 and below it, |ln g| and ω.
    nb::object common_factors() {
        std::vector<double> found;
        {
            nb::gil_scoped_release release;
            const auto [up, down] = gainroom::LoopCurves(*samples_).common_factors();
            found = {up.margin, up.omega, down.margin, down.omega};
        }
        return owned(found.data(), 2, 2);
    }

    // (c, 2): ln g and ω.
    nb::object passing_factors() {
        std::vector<double> found;
        {
            nb::gil_scoped_release release;
            for (const gainroom::MovingMargin& one : gainroom::LoopCurves(*samples_).passing_factors())
                found.insert(found.end(), {one.margin, one.omega});
        }
        return owned(found.data(), found.size() / 2, 2);
    }

    // (c, 3): which loop, or locus, phase and ω.
    nb::object phases(bool locus) {
        std::vector<double> found;
        {
            nb::gil_scoped_release release;
            for (const gainroom::MovingMargin& one : gainroom::LoopCurves(*samples_).phases(locus))
                found.insert(found.end(), {static_cast<double>(one.which), one.margin, one.omega});
        }
        return owned(found.data(), found.size() / 3, 3);
    }

    // (c, 3): which loop, |S_ii| and ω, at the samples and at the peaks between them.
    nb::object sensitivities() {
        std::vector<double> found;
        {
            nb::gil_scoped_release release;
            for (const auto& sample : samples_->samples())
                for (std::size_t i = 0; i < sample->sensitivity.size(); i++)
                    found.insert(found.end(), {static_cast<double>(i), std::abs(sample->sensitivity[i]), sample->omega()});
            for (const gainroom::MovingMargin& one : gainroom::SensitivityPeaks(*samples_).above(samples_->gains(), 0.0, 1.0, 0.0, false))
                found.insert(found.end(), {static_cast<double>(one.which), one.margin, one.omega});
        }
        return owned(found.data(), found.size() / 3, 3);
    }

    nb::tuple common_phase() {
        gainroom::MovingMargin found;
        {
            nb::gil_scoped_release release;
            found = gainroom::LoopCurves(*samples_).common_phase();
        }
        return nb::make_tuple(found.margin, found.omega);
    }

    // Behind a lag [rad] in all loops.
    std::int64_t crossed(double lag) {
        nb::gil_scoped_release release;
        return samples_->crossed(std::polar(1.0, -lag));
    }

    std::int64_t one_loop_count(std::size_t joint, double change, int gain) {
        require(joint < loop_.loops(), "there is no such loop");
        const gainroom::Gain which = gain_of(gain);
        nb::gil_scoped_release release;
        return samples_->one_loop_count(joint, change, which);
    }

    nb::object growths(int gain) {
        const std::vector<double> found = gainroom::LoopCurves(*samples_).growths(gain_of(gain));
        return owned(found.data(), found.size(), 1);
    }

    nb::tuple crossings(Matrix gains, bool locus, bool axis, double reach, double until) {
        const DirectedGains own = gains_of(loop_, gains);
        std::vector<gainroom::MovingMargin> found;
        {
            nb::gil_scoped_release release;
            found = gainroom::LoopCurves(*samples_).crossings(own, locus, axis, reach, until);
        }
        return columns(found);
    }

    nb::tuple delays(Matrix gains, double longest) {
        const DirectedGains own = gains_of(loop_, gains);
        std::vector<gainroom::MovingMargin> found;
        {
            nb::gil_scoped_release release;
            found = gainroom::LoopCurves(*samples_).delays(own, longest, true);
        }
        return columns(found);
    }

    // (c, 2): delay and ω of each.
    nb::object delay_crossings(double longest) {
        std::vector<double> found;
        for (const gainroom::MovingMargin& one : gainroom::LoopCurves(*samples_).delays(samples_->gains(), longest, false))
            found.insert(found.end(), {one.margin, one.omega});
        return owned(found.data(), found.size() / 2, 2);
    }

    nb::tuple peaks(Matrix gains, double least, double slope, double offset, double until) {
        const DirectedGains own = gains_of(loop_, gains);
        std::vector<gainroom::MovingMargin> found;
        {
            nb::gil_scoped_release release;
            found = gainroom::SensitivityPeaks(*samples_).above(own, least, slope, offset, std::isinf(until), until);
        }
        return columns(found);
    }

    nb::tuple ends(Matrix gains, bool locus, double reach) {
        return columns(gainroom::LoopCurves(*samples_).ends(locus, gains_of(loop_, gains), reach, true));
    }

private:
    // 0: all; 1: kp; 2: kd.
    gainroom::Gain gain_of(int gain) const {
        require(gain >= 0 && gain <= 2 && (gain == 0 || loop_.own()), "one gain is of one loop: 1 for kp, 2 for kd");
        return static_cast<gainroom::Gain>(gain);
    }

    // (c, 2): margin and ω; (c, 2 m): the margin's derivatives.
    nb::tuple columns(const std::vector<gainroom::MovingMargin>& found) const {
        std::vector<double> margins, moves;
        for (const gainroom::MovingMargin& one : found) {
            margins.insert(margins.end(), {one.margin, one.omega});
            moves.insert(moves.end(), one.moves.begin(), one.moves.end());
            moves.resize(margins.size() * loop_.directions);  // 0 where nobody asks
        }
        return nb::make_tuple(owned(margins.data(), found.size(), 2), owned(moves.data(), found.size(), 2 * loop_.directions));
    }

    DirectedLoop& loop_;
    std::unique_ptr<gainroom::LoopSamples> samples_;
};

// The lag [rad] at the crossing of the unit circle about ω by the locus that is nearest to −1 there, and its ω; NaN where it is lost.
static nb::tuple lag_about(DirectedLoop& loop, Matrix gains, double omega) {
    gainroom::LoopSamples none(loop, gains_of(loop, gains));
    const gainroom::MovingMargin found = gainroom::LoopCurves(none).lag_about(omega);
    return nb::make_tuple(found.found ? found.margin : std::numeric_limits<double>::quiet_NaN(), found.omega);
}

static nb::object response(DirectedLoop& loop, Vector omega) {
    std::vector<Complex> found;
    for (std::size_t k = 0; k < omega.size(); k++) {
        gainroom::LoopPoint point;
        require(loop.point(omega.data()[k], point), "the response is not finite");
        found.insert(found.end(), point.seen.begin(), point.seen.end());
    }
    return owned(found.data(), omega.size(), loop.directions * loop.directions);
}

// NaN where `find` does not: of each of the matrices, in a row.
template <typename Find>
static nb::object eigenvalues_of(const Array<const Complex, 3>& matrices, Find find) {
    const std::size_t count = matrices.shape(0), n = matrices.shape(1);
    require(matrices.shape(2) == n, "matrices must be square");
    std::vector<Complex> values(count * n);
    {
        nb::gil_scoped_release release;
        gainroom::Dense work;
        work.shape(n, n);
        for (std::size_t k = 0; k < count; k++) {
            work.copy(matrices.data() + k * n * n);
            if (!find(work.re.data(), work.im.data(), n, &values[k * n]))
                std::fill_n(&values[k * n], n, std::numeric_limits<double>::quiet_NaN());
        }
    }
    return owned(values.data(), count, n);
}

static nb::object eigenvalues(Array<const Complex, 3> matrices) {
    gainroom::Eigenvalues solver;
    return eigenvalues_of(matrices, [&](auto... of) { return solver.find(of...); });
}

static nb::object symmetric_eigenvalues(Array<const Complex, 3> matrices, double error) {
    gainroom::SymmetricEigenvalues solver;
    return eigenvalues_of(matrices, [&](const double* re, const double* im, std::size_t n, Complex* values) {
        return solver.find(re, im, n, error, values);
    });
}

static nb::object inverses(Array<const Complex, 3> matrices) {
    const std::size_t count = matrices.shape(0), n = matrices.shape(1);
    require(matrices.shape(2) == n, "matrices must be square");
    std::vector<Complex> found(count * n * n);
    bool regular = true;
    {
        nb::gil_scoped_release release;
        gainroom::Dense work;
        gainroom::Vector<std::size_t> exchanged;
        work.shape(n, n);
        for (std::size_t k = 0; regular && k < count; k++) {
            gainroom::LogDeterminant determinant;
            work.copy(matrices.data() + k * n * n);
            regular = invert(work, exchanged, determinant);
            for (std::size_t e = 0; e < n * n; e++) found[k * n * n + e] = {work.re[e], work.im[e]};
        }
    }
    require(regular, "a matrix is singular");
    return owned(found.data(), count, n * n);
}

static nb::object paired(Array<const Complex, 2> before, Array<const Complex, 2> after) {
    const std::size_t steps = before.shape(0), size = before.shape(1);
    require(after.shape(0) == steps && after.shape(1) == size, "before and after must be (k, n)");
    for (const auto* part : {&before, &after})
        for (std::size_t k = 0; k < part->size(); k++)
            require(std::isfinite(part->data()[k].real()) && std::isfinite(part->data()[k].imag()), "eigenvalues must be finite");
    std::vector<std::int64_t> found;
    {
        nb::gil_scoped_release release;
        for (std::size_t k = 0; k < steps; k++) {
            gainroom::Loci low, high;
            low.values.assign(before.data() + k * size, before.data() + (k + 1) * size);
            high.values.assign(after.data() + k * size, after.data() + (k + 1) * size);
            low.describe();
            high.describe();
            const std::vector<std::size_t> pairs = gainroom::paired(low, high);
            found.insert(found.end(), pairs.begin(), pairs.end());
        }
    }
    return owned(found.data(), steps, size);
}

void bind_look(nb::module_& m) {
    m.def("eigenvalues", &eigenvalues, nb::arg("matrices"));
    m.def("symmetric_eigenvalues", &symmetric_eigenvalues, nb::arg("matrices"), nb::arg("error"));
    m.def("inverses", &inverses, nb::arg("matrices"));
    m.def("paired", &paired, nb::arg("before"), nb::arg("after"));
    nb::class_<DirectedLoop>(m, "DirectedLoop")
        .def("__init__",
             [](DirectedLoop* self, std::size_t size, Matrix torque, Matrix jacobian, Integers cascade, bool by_direction) {
                 const std::size_t directions = cascade.size();
                 require(size > 0 && directions > 0, "a loop needs a joint and a direction");
                 require((torque.size() == 0 && jacobian.size() == 0 && directions == size) ||
                             (has_shape(torque, size, directions) && has_shape(jacobian, directions, size)),
                         "torque (n, m) and jacobian (m, n) do not fit");
                 new (self) DirectedLoop();
                 self->actuated.size = size;
                 self->directions = directions;
                 self->torque = listed(torque);
                 self->jacobian = listed(jacobian);
                 self->by_direction = by_direction;
                 for (std::size_t k = 0; k < directions; k++) self->cascade.push_back(cascade.data()[k] != 0);
             },
             nb::arg("size"), nb::arg("torque"), nb::arg("jacobian"), nb::arg("cascade"),
             nb::arg("by_direction") = false)
        .def("set_plant", &set_plant, nb::arg("mobility"), nb::arg("joints"), nb::arg("root"), nb::arg("gravity"), nb::arg("hung"),
             nb::arg("contacts"), nb::arg("drives"), nb::arg("motor_side"))
        .def("set_held", &set_held, nb::arg("a"), nb::arg("b"), nb::arg("c"), nb::arg("hessenberg"), nb::arg("turned_b"), nb::arg("turned_c"),
             nb::arg("fast"), nb::arg("delay"), nb::arg("step"))
        .def("set_modes", &set_modes, nb::arg("modes"))
        .def("set_law", &set_law, nb::arg("velocity_above"), nb::arg("velocity_below"), nb::arg("integral_above"), nb::arg("integral_below"),
             nb::arg("zeros"), nb::arg("poles"), nb::arg("gain"))
        .def("set_matrix", &set_matrix, nb::arg("gain"), nb::arg("velocity"), nb::arg("integral"), nb::arg("slow"))
        .def("set_boundary", &set_boundary, nb::arg("grid"), nb::arg("leaning"), nb::arg("tilt"), nb::arg("lean"), nb::arg("unstable_poles"), nb::arg("settles"))
        .def("response", &response, nb::arg("omega"))
        .def("lag_about", &lag_about, nb::arg("gains"), nb::arg("omega"));
    nb::class_<Look>(m, "Look")
        .def(nb::init<DirectedLoop&, Matrix, double, double, double, bool, bool>(), nb::keep_alive<1, 2>(), nb::arg("loop"), nb::arg("gains"),
             nb::arg("factor"), nb::arg("phase"), nb::arg("peak"), nb::arg("between"), nb::arg("smooth"))
        .def_prop_ro("followed", &Look::followed)
        .def_prop_ro("singular", &Look::singular)
        .def_prop_ro("unstable", &Look::unstable)
        .def_prop_ro("samples", &Look::samples)
        .def("tell_apart", &Look::tell_apart, nb::arg("factor"), nb::arg("phase"))
        .def("least", &Look::least, nb::arg("apart") = true)
        .def("peak", &Look::peak, nb::arg("slope"), nb::arg("offset"))
        .def("one_loop", &Look::one_loop)
        .def("one_loop_crossings", &Look::one_loop_crossings, nb::arg("which"))
        .def("common_factors", &Look::common_factors)
        .def("passing_factors", &Look::passing_factors)
        .def("phases", &Look::phases, nb::arg("locus"))
        .def("sensitivities", &Look::sensitivities)
        .def("common_phase", &Look::common_phase)
        .def("crossed", &Look::crossed, nb::arg("lag"))
        .def("one_loop_count", &Look::one_loop_count, nb::arg("joint"), nb::arg("change"), nb::arg("gain"))
        .def("growths", &Look::growths, nb::arg("gain"))
        .def("crossings", &Look::crossings, nb::arg("gains"), nb::arg("locus"), nb::arg("axis"), nb::arg("reach"),
             nb::arg("until") = 0.0)
        .def("delays", &Look::delays, nb::arg("gains"), nb::arg("longest"))
        .def("delay_crossings", &Look::delay_crossings, nb::arg("longest"))
        .def("peaks", &Look::peaks, nb::arg("gains"), nb::arg("least"), nb::arg("slope"), nb::arg("offset"),
             nb::arg("until") = std::numeric_limits<double>::infinity())
        .def("ends", &Look::ends, nb::arg("gains"), nb::arg("locus"), nb::arg("reach"));
}
