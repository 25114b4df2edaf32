// gainroom.native._core: the C++ core for Python.
#include <nanobind/nanobind.h>

namespace nb = nanobind;

void bind_scan(nb::module_& m);
void bind_simulation(nb::module_& m);
void bind_identification(nb::module_& m);
void bind_coupled(nb::module_& m);
void bind_tracker(nb::module_& m);
void bind_look(nb::module_& m);
void bind_disk(nb::module_& m);
void bind_robot(nb::module_& m);
void bind_boxes(nb::module_& m);
void bind_programme(nb::module_& m);
void bind_compliance(nb::module_& m);

NB_MODULE(_core, m) {
    nb::set_leak_warnings(false);  // a command leaves all that it holds to the system as it ends (cli/__init__.py): that is no leak
    m.doc() = "gainroom's C++ core; see src/gainroom/native/include/gainroom.";
    bind_scan(m);
    bind_simulation(m);
    bind_identification(m);
    bind_coupled(m);
    bind_tracker(m);
    bind_look(m);
    bind_disk(m);
    bind_robot(m);
    bind_boxes(m);
    bind_programme(m);
    bind_compliance(m);
}
