#include "gainroom/link_compliance.hpp"

#include "arrays.hpp"

void bind_compliance(nb::module_& m) {
    m.def(
        "link_compliance",
        [](Matrix springs, std::size_t joints, Matrix inner, Vector omega, Array<const gainroom::Complex, 2> stiffness, bool whole) {
            const std::size_t rows = springs.shape(0), r = springs.shape(1), count = omega.size(), each = whole ? joints * joints : joints;
            require(joints <= rows, "joints must be the first rows of springs (c, r)");
            require(has_shape(inner, r, r), "inner must have the shape (r, r)");
            require(stiffness.shape(0) == count && stiffness.shape(1) == rows, "stiffness must have the shape (k, c), and omega (k,)");
            std::vector<gainroom::Complex> found(count * each);
            {
                nb::gil_scoped_release release;
                gainroom::LinkCompliance(springs.data(), inner.data(), rows, joints, r).at(omega.data(), stiffness.data(), count, whole, found.data());
            }
            return owned(found.data(), count, each);
        },
        nb::arg("springs"), nb::arg("joints"), nb::arg("inner"), nb::arg("omega"), nb::arg("stiffness"), nb::arg("whole"),
        "Diagonal (k, n), or whole (k, n n), of R (-omega^2 I + inner + H^T Y H)^-1 R^T, H (c, r) = springs, R its first n = joints rows, Y = "
        "stiffness (k, c).");
}
