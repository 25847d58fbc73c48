from setuptools import find_packages, setup

setup(
    name="nmt_pll",
    version="0.4.0",
    packages=find_packages(exclude=["test"]),
    package_data={"": ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/nmt_pll"]),
        ("share/nmt_pll", ["package.xml"]),
    ],
    install_requires=[
        "numpy>=1.26",
    ],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    maintainer="nmt developers",
    maintainer_email="nmt@example.org",
    description="Phase-locked loop for phase resonance testing; PLL node",
    license="Apache-2.0",
    entry_points={"console_scripts": ["pll = nmt_pll.pll_node:main"]},
)
