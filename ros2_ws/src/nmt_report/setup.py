from setuptools import find_packages, setup

setup(
    name="nmt_report",
    version="0.4.0",
    packages=find_packages(exclude=["test"]),
    package_data={"": ["py.typed", "templates/*"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/nmt_report"]),
        ("share/nmt_report", ["package.xml"]),
    ],
    install_requires=[
        "jinja2>=3.1",
        "matplotlib>=3.6",
        "numpy>=1.26",
        "rich>=13.7",
    ],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    maintainer="nmt developers",
    maintainer_email="nmt@example.org",
    description="Pages, figures and tables of tests, responses and diagnoses",
    license="Apache-2.0",
)
