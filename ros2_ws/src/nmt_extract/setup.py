from setuptools import find_packages, setup

setup(
    name="nmt_extract",
    version="0.4.0",
    packages=find_packages(exclude=["test"]),
    package_data={"": ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/nmt_extract"]),
        ("share/nmt_extract", ["package.xml"]),
    ],
    install_requires=[
        "contourpy>=1.0",
        "numpy>=1.26",
        "pyuff>=2.4",
        "scipy>=1.11",
        "sdypy-EMA>=0.31",
    ],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    maintainer="nmt developers",
    maintainer_email="nmt@example.org",
    description="Modal properties from locked windows, live and from bags; extraction node",
    license="Apache-2.0",
    entry_points={"console_scripts": ["extract = nmt_extract.extract_node:main"]},
)
