# The demonstration, rendered and scored: docker build -t objconnect . && docker run --rm -v "$PWD/runs:/objconnect/runs" objconnect
FROM python:3.11-slim
RUN apt-get update && apt-get install -y --no-install-recommends \
    make libx11-6 libxrender1 libxfixes3 libxi6 libxext6 libxkbcommon0 libsm6 libice6 libgl1 \
    && rm -rf /var/lib/apt/lists/*
WORKDIR /objconnect
COPY . .
RUN make install
CMD ["make", "demo"]
